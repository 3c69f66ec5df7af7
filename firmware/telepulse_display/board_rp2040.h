// Raspberry Pi Pico and other RP2040 boards, by the core of Earle Philhower. See board.h.
#pragma once

const char CHIP_NAME[] = "RP2040";
const uint8_t STEP_PIN = 2, DIRECTION_PIN = 3, ENABLE_PIN = 4, HOME_PIN = 5, FAULT_PIN_IN = 6;
const uint8_t FILM_PIN = A0;

#define KEPT_OVER_RESET __attribute__((section(".uninitialized_data.telepulse")))

#include "board_serial.h"

repeating_timer_t step_timer;

bool on_step_timer(repeating_timer_t *) {
  stepper_tick();
  return true;
}

inline void board_begin(uint32_t baud) {
  begin_pins_and_line(baud);
  // Negative: from start to start.
  add_repeating_timer_us(-(int64_t)(1000000 / TICK_HZ), on_step_timer, nullptr, &step_timer);
  rp2040.wdt_begin(30);
}

inline void board_alive() { rp2040.wdt_reset(); }

inline uint8_t board_reset_cause() {
  int cause = rp2040.getResetReason();
  if (cause == RP2040::PWRON_RESET) return RESET_POWER_UP;
  if (cause == RP2040::BROWNOUT_RESET) return RESET_BROWN_OUT;
  if (cause == RP2040::WDT_RESET) return RESET_WATCHDOG;
  return cause == RP2040::RUN_PIN_RESET ? RESET_PIN : RESET_UNKNOWN;
}
