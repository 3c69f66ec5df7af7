// ESP32 development boards, by Espressif's core 3. See board.h.
#pragma once

#include <esp_system.h>
#include <esp_task_wdt.h>

const char CHIP_NAME[] = "ESP32";
const uint8_t STEP_PIN = 25, DIRECTION_PIN = 26, ENABLE_PIN = 27, HOME_PIN = 32, FAULT_PIN_IN = 33;
// One of the first converter; the second one serves the radio.
const uint8_t FILM_PIN = 34;

#define KEPT_OVER_RESET RTC_NOINIT_ATTR

#include "board_serial.h"

void ARDUINO_ISR_ATTR on_step_timer() { stepper_tick(); }

inline void board_begin(uint32_t baud) {
  begin_pins_and_line(baud);
  hw_timer_t *timer = timerBegin(1000000);
  timerAttachInterrupt(timer, on_step_timer);
  timerAlarm(timer, 1000000 / TICK_HZ, true, 0);
  esp_task_wdt_config_t watchdog = {};
  watchdog.timeout_ms = 30;
  watchdog.trigger_panic = true;
  esp_task_wdt_reconfigure(&watchdog);
  esp_task_wdt_add(nullptr);
}

inline void board_alive() { esp_task_wdt_reset(); }

inline uint8_t board_reset_cause() {
  int cause = esp_reset_reason();
  if (cause == ESP_RST_POWERON) return RESET_POWER_UP;
  if (cause == ESP_RST_BROWNOUT) return RESET_BROWN_OUT;
  if (cause == ESP_RST_TASK_WDT || cause == ESP_RST_WDT) return RESET_WATCHDOG;
  return cause == ESP_RST_EXT ? RESET_PIN : RESET_UNKNOWN;
}
