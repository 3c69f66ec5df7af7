// Step and direction from a signed step rate: the paper's voltage-controlled oscillator as a phase
// accumulator, within bounds of position, rate and acceleration.
//
// `stepper_tick` runs in the timer's interrupt, the rest in the main loop.
#pragma once

#include <math.h>

#include "board.h"

// From a rate's bound to its effect, so that a bounded rate ends before the bound of position.
const float LATE_S = 2e-3;
const uint8_t TICKS_PER_MS = TICK_HZ / 1000;

// Written by the interrupt: counts modulo their type, which the main loop extends. That of steps
// begins anywhere.
volatile uint16_t tick_steps KEPT_OVER_RESET;
volatile uint8_t tick_ms = 0;
uint8_t ticks_left = TICKS_PER_MS;
phase_t tick_phase = 0;
bool tick_step = false;
// Written by the main loop: phase of a tick, modulo its type, whose whole turn is a step; the
// direction, inward at rest; level of the direction pin towards the finger. Both: steps until the
// bound in this direction.
volatile phase_t tick_increment = 0;
volatile bool tick_inward = true;
volatile bool inward_level = true;
volatile uint16_t tick_room = 0;

// Give the step that the last tick has found, and find the next one. The direction so precedes its
// step by a tick. At a bound the phase waits before the step, so that the way back begins at once.
static void stepper_tick() {
  bool step = tick_step;
  if (step) {
    pin_step(true);
    wait_for_pulse();
  }
  tick_step = false;
  bool inward = tick_inward;
  phase_t phase = tick_phase, next = phase + tick_increment;
  tick_phase = next;
  if ((next < phase) == inward) {
    uint16_t room = tick_room;
    if (room) {
      tick_room = room - 1;
      tick_step = true;
      pin_direction(inward == inward_level);
      tick_steps = tick_steps + (inward ? 1 : -1);
    } else {
      tick_phase = inward ? LAST_PHASE : 0;
    }
  }
  if (--ticks_left == 0) {
    ticks_left = TICKS_PER_MS;
    tick_ms = tick_ms + 1;
  }
  if (step) pin_step(false);
}

struct Stepper {
  // In steps/s, steps/s², and steps.
  float velocity = 0;
  float wanted = 0;
  float acceleration = 1000;
  int32_t position = 0;
  // Of `position`.
  uint16_t counted_steps = 0;
  // Where steps end, from the next millisecond on.
  int32_t lowest = 0, highest = 0;

  // Return the milliseconds since the last call.
  uint8_t passed_ms() {
    uint8_t ms = tick_ms, passed = ms - counted_ms;
    counted_ms = ms;
    return passed;
  }

  void read_position() {
    noInterrupts();
    uint16_t steps = tick_steps;
    interrupts();
    position += (int16_t)(steps - counted_steps);
    counted_steps = steps;
  }

  void bound(int32_t least, int32_t most) {
    lowest = least;
    highest = most;
  }

  // Approach the wanted rate for a time, slowly enough to end at a bound.
  void follow(float seconds) {
    float goal = wanted;
    if (goal) {
      float most = fastest(goal < 0 ? position - lowest : highest - position);
      goal = constrain(goal, -most, most);
    }
    float change = acceleration * seconds;
    velocity += constrain(goal - velocity, -change, change);
    set(velocity);
  }

  // Stop without a ramp.
  void halt() { set(velocity = wanted = 0); }

private:
  // The rate v for which v·LATE_S + v²/2a is the distance left.
  float fastest(int32_t left) const {
    if (left <= 0) return 0;
    float late = acceleration * LATE_S;
    return sqrtf(late * late + 2 * acceleration * left) - late;
  }

  void set(float steps_per_s) {
    // Just below a step a tick.
    float turn = fabsf(steps_per_s) * ((float)LAST_PHASE / TICK_HZ);
    phase_t increment = turn < (float)LAST_PHASE ? (uint32_t)turn : LAST_PHASE;
    bool inward = steps_per_s >= 0 || !increment;
    int32_t room = inward ? highest - position : position - lowest;
    noInterrupts();
    int16_t moved = tick_steps - counted_steps;
    room -= inward ? moved : -moved;
    tick_room = room < 0 ? 0 : room > 0xFFFF ? 0xFFFF : room;
    tick_inward = inward;
    tick_increment = inward ? increment : -increment;
    interrupts();
  }

  uint8_t counted_ms = 0;
};
