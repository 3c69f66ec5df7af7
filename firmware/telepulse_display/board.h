// What depends on the board: pins, a timer that calls `stepper_tick`, and these functions.
//
//   board_begin(baud)    pins at rest with the motor off; timer, converter, line, watchdog started
//   board_film(halves)   the film's counts in the two halves of the last millisecond, each up to
//                        FILM_FULL_SCALE / 2
//   board_alive()        restart the processor's watchdog, which else resets it after some 30 ms
//   board_reset_cause()  0 unknown, 1 power-up, 2 reset pin, 3 brown-out, 4 watchdog
//   board_read()         the next byte of the host; -1 if there is none
//   board_writable()     bytes that board_write takes without waiting
//   board_write(bytes, count)
//
// Pins are stated in each board_*.h, which may write their ports directly.
//
// board_avr.h is compiled with avr-gcc and Arduino's core, and run on an emulated ATmega328P, by
// telepulse's tests. board_host.h is for emulators and tests on this machine: see firmware/host.
// board_rp2040.h has been compiled, not linked, with arm-none-eabi-gcc 12.2 and the headers of its
// core, and NOT been run. An ESP32 needs a board_*.h of its own.
#pragma once

#include <Arduino.h>

enum ResetCause : uint8_t {
  RESET_UNKNOWN,
  RESET_POWER_UP,
  RESET_PIN,
  RESET_BROWN_OUT,
  RESET_WATCHDOG
};

// Called in the timer's interrupt, TICK_HZ times a second; the number of ticks left in this ms.
static void stepper_tick();
extern uint8_t ticks_left;

#if defined(__AVR_ATmega328P__)
#include "board_avr.h"
#elif defined(ARDUINO_ARCH_RP2040)
#include "board_rp2040.h"
#elif defined(TELEPULSE_HOST)
#include "board_host.h"
#else
#error "No board_*.h for this board yet: see board.h for what it contains."
#endif
