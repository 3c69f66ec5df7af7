/* The motor, screw, rubber, fingertip and film of an emulated finger's board: C, and C++.
 *
 * The motor is a two-phase stepper: its force is a sine of the lag, so that it loses four steps
 * where it lags by more than two. The screw does not turn under load while the motor is off. Not
 * modelled: currents, torque over speed, warmth, backlash.
 */
#pragma once

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* e^20 times the knee is beyond what any motor gives. */
#define MOST_STIFFENED 20

struct mechanics {
  /* Settings. A NEMA 17 of 0.4 N m and 200 steps a turn, as thrust and mass at a lead of 2 mm. */
  double microsteps, lead_mm, thrust_n, mass_kg, damping;
  /* From home to first touch; the tip at power-up, from first touch. */
  double touch_mm, start_mm;
  /* The rubber's force in N is hertz times depth^1.5 in m. */
  double hertz, finger_n_per_m;
  /* Or, where knee_n is above 0, tissue from a clearance on: knee_n times exp(depth / length) - 1. */
  double knee_n, length_mm, clearance_mm;
  double film_zero_v, film_v_per_n, film_noise_v;
  /* 1: the tip is where the count is, without a motor's dynamics, which takes far less time. */
  double rigid;
  /* Faults: steps that the shaft turns for a step into the finger, and for one away from it; the
   * film's output whatever the force, in V, or NAN; the switch stuck open 0 or closed 1, or -1. */
  double turns_in, turns_out, film_v, stuck_switch;
  /* State. Steps that the carrier has taken; the tip from first touch. */
  double steps, step_m, turn_m, tip_m, speed_m_per_s, force_n;
  int64_t lost_steps;
  uint32_t noise;
};

static const struct mechanics USUAL_MECHANICS = {
    .microsteps = 16,
    .lead_mm = 2,
    .thrust_n = 1200,
    .mass_kg = 53,
    .damping = 0.2,
    .touch_mm = 2,
    .start_mm = -1,
    .hertz = 6.285e6,
    .finger_n_per_m = 1000,
    .knee_n = 0,
    .length_mm = 1,
    .clearance_mm = 0,
    .film_zero_v = 2.5,
    .film_v_per_n = 0.51,
    .film_noise_v = 0.003,
    .rigid = 0,
    .turns_in = 1,
    .turns_out = 1,
    .film_v = NAN,
    .stuck_switch = -1,
    .steps = 0,
    .step_m = 0,
    .turn_m = 0,
    .tip_m = 0,
    .speed_m_per_s = 0,
    .force_n = 0,
    .lost_steps = 0,
    .noise = 1,
};

/* Return the setting of a name; NULL where there is none. */
static inline double *mechanics_setting(struct mechanics *m, const char *name) {
  const struct {
    const char *name;
    double *value;
  } settings[] = {
      {"microsteps", &m->microsteps},
      {"lead_mm", &m->lead_mm},
      {"thrust_n", &m->thrust_n},
      {"mass_kg", &m->mass_kg},
      {"damping", &m->damping},
      {"touch_mm", &m->touch_mm},
      {"start_mm", &m->start_mm},
      {"hertz", &m->hertz},
      {"finger_n_per_m", &m->finger_n_per_m},
      {"knee_n", &m->knee_n},
      {"length_mm", &m->length_mm},
      {"clearance_mm", &m->clearance_mm},
      {"film_zero_v", &m->film_zero_v},
      {"film_v_per_n", &m->film_v_per_n},
      {"film_noise_v", &m->film_noise_v},
      {"rigid", &m->rigid},
      {"turns_in", &m->turns_in},
      {"turns_out", &m->turns_out},
      {"film_v", &m->film_v},
      {"stuck_switch", &m->stuck_switch},
  };
  for (size_t i = 0; i < sizeof settings / sizeof *settings; i++)
    if (!strcmp(settings[i].name, name)) return settings[i].value;
  return NULL;
}

/* Return the force at a depth from first touch: that of tissue, or of rubber on a fingertip, whose
 * indentations add up to the depth. */
static inline double mechanics_contact_n(const struct mechanics *m, double depth_m) {
  if (depth_m <= 0) return 0;
  if (m->knee_n > 0) {
    double depth_mm = 1e3 * depth_m - m->clearance_mm;
    return depth_mm <= 0 ? 0 : m->knee_n * expm1(fmin(depth_mm / m->length_mm, MOST_STIFFENED));
  }
  double rubber = 1 / cbrt(m->hertz * m->hertz), finger = 1 / m->finger_n_per_m;
  /* The cube root of the force. One term left out, the start is above it, and Newton's method goes
   * down alone; from below it would leap far beyond. */
  double root = fmin(sqrt(depth_m / rubber), cbrt(depth_m / finger));
  for (int i = 0; i < 60; i++) {
    double change = (root * root * (finger * root + rubber) - depth_m) /
                    (root * (3 * finger * root + 2 * rubber));
    root -= change;
    if (change <= 1e-13 * root) break;
  }
  return root * root * root;
}

/* Take the tip to its place at power-up. */
static inline void mechanics_begin(struct mechanics *m) {
  m->turn_m = 1e-3 * m->lead_mm / 50;
  m->step_m = m->turn_m / 4 / m->microsteps;
  m->steps = round(1e-3 * m->start_mm / m->step_m);
  m->tip_m = m->steps * m->step_m;
  m->force_n = mechanics_contact_n(m, m->tip_m);
}

/* Take a step of the carrier, with the motor on: direction 1 into the finger, or -1. */
static inline void mechanics_step(struct mechanics *m, int direction) {
  m->steps += direction > 0 ? m->turns_in : -m->turns_out;
  if (m->rigid) m->tip_m = m->steps * m->step_m;
}

/* Let the motor move for a time. */
static inline void mechanics_move(struct mechanics *m, bool motor_on, double time_s) {
  if (m->rigid) {
  } else if (motor_on) {
    double lag_m = m->steps * m->step_m - m->tip_m;
    double rate = sqrt(m->thrust_n * 2 * M_PI / m->turn_m / m->mass_kg);
    double pull_n = m->thrust_n * sin(2 * M_PI * lag_m / m->turn_m) - m->force_n;
    m->speed_m_per_s += (pull_n / m->mass_kg - 2 * m->damping * rate * m->speed_m_per_s) * time_s;
    m->tip_m += m->speed_m_per_s * time_s;
    /* The carrier's count follows a motor that has slipped by whole electrical turns. */
    double slipped = round(lag_m / m->turn_m) * 4 * m->microsteps;
    m->steps -= slipped;
    m->lost_steps += (int64_t)fabs(slipped);
  } else {
    m->speed_m_per_s = 0;
  }
  m->force_n = mechanics_contact_n(m, m->tip_m);
}

static inline bool mechanics_switch_closed(const struct mechanics *m) {
  return m->stuck_switch < 0 ? m->tip_m <= -1e-3 * m->touch_mm : m->stuck_switch > 0;
}

/* Return the output of the film's amplifier now, with its noise. */
static inline double mechanics_film_v(struct mechanics *m) {
  double noise = -6;
  for (int i = 0; i < 12; i++) {
    m->noise = m->noise * 1664525u + 1013904223u;
    noise += m->noise / 4294967296.0;
  }
  double volts = isnan(m->film_v) ? m->film_zero_v + m->film_v_per_n * m->force_n : m->film_v;
  return volts + m->film_noise_v * noise;
}

/* Return what a converter of 10 bits and 5 V reads. */
static inline uint16_t mechanics_reading(double volts) {
  return (uint16_t)fmin(fmax(floor(volts / 5 * 1024), 0), 1023);
}
