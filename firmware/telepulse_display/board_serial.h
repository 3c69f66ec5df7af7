// What 32-bit boards share, by functions of any Arduino core. See board.h.
#pragma once

// Phases of four bytes.
typedef uint32_t phase_t;
const uint32_t LAST_PHASE = 0xFFFFFFFF;
const uint32_t TICK_HZ = 40000;
// The largest sum of conversions of 12 bits that a state frame holds has eight of them.
const uint8_t CONVERSIONS = 8;
const uint16_t FILM_FULL_SCALE = CONVERSIONS * 4095;

inline void pin_step(bool high) { digitalWrite(STEP_PIN, high); }
inline void pin_direction(bool high) { digitalWrite(DIRECTION_PIN, high); }
inline void pin_enable(bool on) { digitalWrite(ENABLE_PIN, !on); }
inline bool pin_home() { return digitalRead(HOME_PIN); }
inline bool pin_fault() { return digitalRead(FAULT_PIN_IN); }
// A DRV8825 needs 1.9 us.
inline void wait_for_pulse() { delayMicroseconds(2); }

inline void begin_pins_and_line(uint32_t baud) {
  digitalWrite(ENABLE_PIN, HIGH);
  pinMode(ENABLE_PIN, OUTPUT);
  digitalWrite(ENABLE_PIN, HIGH);
  pinMode(STEP_PIN, OUTPUT);
  pinMode(DIRECTION_PIN, OUTPUT);
  pinMode(HOME_PIN, INPUT_PULLUP);
  pinMode(FAULT_PIN_IN, INPUT_PULLUP);
  analogReadResolution(12);
  Serial.begin(baud);
}

// Here both halves are of the present moment.
inline void board_film(uint16_t *halves) {
  for (uint8_t half = 0; half < 2; half++) {
    halves[half] = 0;
    for (uint8_t i = 0; i < CONVERSIONS / 2; i++) halves[half] += analogRead(FILM_PIN);
  }
}

inline int16_t board_read() { return Serial.read(); }
inline uint8_t board_writable() { return min((int)Serial.availableForWrite(), 255); }
inline void board_write(const uint8_t *bytes, uint8_t count) { Serial.write(bytes, count); }
