// This machine, in place of a board: firmware/host/host.cpp lets time pass and drives the pins. The
// figures are those of board_avr.h, so that both give the same steps.
#pragma once

const uint32_t TICK_HZ = 32000;
const uint32_t LAST_PHASE = 0xFFFFFF;
const uint16_t FILM_FULL_SCALE = 16 * 1023;
const char CHIP_NAME[] = "emulated";

// Three bytes, as of the AVR: modulo 2^24.
class phase_t {
public:
  phase_t() = default;
  phase_t(uint32_t number) : value(number & LAST_PHASE) {}
  phase_t(const phase_t &) = default;
  phase_t(const volatile phase_t &other) : value(other.value) {}
  phase_t &operator=(const phase_t &) = default;
  void operator=(const phase_t &other) volatile { value = other.value; }
  operator uint32_t() const { return value; }
  operator uint32_t() const volatile { return value; }
  phase_t operator-() const { return phase_t(-value); }

private:
  uint32_t value;
};

// Sections are named differently in an ELF file and in one of macOS.
#ifdef __APPLE__
#define KEPT_OVER_RESET __attribute__((section("__DATA,over_reset")))
#else
#define KEPT_OVER_RESET __attribute__((section("over_reset")))
#endif

void pin_step(bool high);
void pin_direction(bool high);
void pin_enable(bool on);
bool pin_home();
bool pin_fault();
inline void wait_for_pulse() {}

void board_begin(uint32_t baud);
void board_film(uint16_t *halves);
void board_alive();
uint8_t board_reset_cause();
int16_t board_read();
uint8_t board_writable();
void board_write(const uint8_t *bytes, uint8_t count);
