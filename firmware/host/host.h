/* The sketch of the finger's board, compiled for this machine, at the motor of mechanics.h.
 *
 *   g++ -std=c++20 -O2 -fPIC -fvisibility=hidden -fwrapv -ffp-contract=off -shared -I.
 *     -DTELEPULSE_HOST begin.cpp host.cpp end.cpp -o board.so   (in this order: see begin.cpp)
 *
 * There is no clock: time passes in host_run alone, at any speed. One board is present; a caller
 * of several keeps the others by host_save, which copies less than 3 kB, and host_restore. State is
 * restored in the process that saved it. What is linked behind end.cpp is not part of it. Run on
 * Linux; the names that macOS has for a section's ends have not been tried.
 *
 * A millisecond has 32 calls of stepper_tick(). After each 16 the line brings and takes up to 25
 * bytes, as at 500 kbaud, and loop() is called until it has read what has come. So bytes that are
 * fed before a millisecond are executed in it, as far as they are 50, and the state frame at its
 * end can be taken after the next one. While loop() waits for the line, and before it guards its
 * second access to the interrupt's variables, ticks pass.
 */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
#define HOST_API extern "C" __attribute__((visibility("default")))
#else
#define HOST_API
#endif

/* The board and its surroundings at present. Rates in steps/s; steps are positive into the finger. */
struct host_view {
  /* Of mechanics.h: the tip from first touch, the force under it, steps that the motor lost. */
  double tip_m, force_n;
  int64_t lost_steps;
  /* Ticks since the emulation's begin; edges of the step pin: into the finger and away with the
   * motor on, and with the motor off; resets by the processor's watchdog. */
  int64_t ticks, steps_in, steps_out, steps_off, hangs;
  /* Bytes that were dropped: sent, and nobody took them; fed, and there was no room. */
  int64_t dropped;
  /* The sketch's variables. */
  float velocity, wanted;
  int32_t position, lowest, highest, began_at;
  uint32_t present_ms;
  uint32_t search_opening;
  int32_t limits_lowest, limits_highest;
  uint32_t limits_acceleration, limits_highest_rate, limits_withdrawal, limits_withdrawal_rate;
  uint16_t limits_film_least, limits_film_most, limits_watchdog_ms, film, sequence;
  uint8_t limits_options, state, cause, rejected, homed, home_closed, faulty, film_outside;
  uint8_t has_limits, expired;
  /* Pins. */
  uint8_t motor_on, step_pin, direction_pin, home_pin, fault_pin;
};

/* Make a new board, without power, with the usual settings. Returns false where the linker has put
 * the variables elsewhere than begin.cpp requires. */
HOST_API bool host_new(void);

/* Change a setting. Those of mechanics.h; lengths before host_power_up.
 * Wiring: inverted 1 (the direction pin's low level leads into the finger), normally_closed 1 (the
 * switch opens at home), fault_pin 0 (not connected), 1 (low in a fault) or 2 (high).
 * Faults: fault 1 (the carrier's fault pin is active), carrier_off 1 (the carrier gives the motor
 * no current), hung 1 (loop() does not return).
 * busy_ticks: those that pass while loop() computes a rate, by default as on an ATmega328P.
 * Returns false where there is none of that name. */
HOST_API bool host_set(const char *name, double value);

/* Power up: memory that a reset keeps is void. Or reset, with a cause of PROTOCOL.md's greeting; a
 * bootloader then waits for a time, with the motor off. */
HOST_API void host_power_up(void);
HOST_API void host_reset(uint8_t cause, uint32_t bootloader_ms);

/* Set the counters of microseconds and milliseconds, to be near their end. */
HOST_API void host_set_clock(uint32_t us, uint32_t ms);

/* Let milliseconds pass, each with all that loop() does at its end. */
HOST_API void host_run(uint32_t ms);

/* Give bytes to the board; returns how many there was room for. Take bytes that it has sent. */
HOST_API uint32_t host_feed(const uint8_t *bytes, uint32_t count);
HOST_API uint32_t host_take(uint8_t *bytes, uint32_t most);

/* Set the film's counts in the halves of each millisecond; below 0: by the amplifier again. */
HOST_API void host_film(int32_t first, int32_t second);

HOST_API void host_look(struct host_view *view);

HOST_API uint32_t host_state_bytes(void);
HOST_API void host_save(void *state);
HOST_API void host_restore(const void *state);
