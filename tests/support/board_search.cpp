// Searches for a sequence of commands, inputs and silences after which the finger's board does what
// PROTOCOL.md excludes: board_search.py compiles it in the place of firmware/host/host.cpp.
//
// What is checked is stated from the outside: the edges of the step pin, the enable pin, the film
// that was given, the commands that were sent and their answers. Of the sketch's variables it reads
// its state, its count and its flags of homed and switch.
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <algorithm>
#include <type_traits>
#include <vector>

#include "../mechanics.h"

static inline void watched_step(struct mechanics *m, int direction);

// Each step of the carrier passes the checks, before the mechanics.
#define mechanics_step watched_step
#include "world.cpp"
#undef mechanics_step

// ---- A script ----------------------------------------------------------------------------------

// Commands have the numbers of their formats.
enum Kind : int32_t { RAW, GARBAGE, STREAM, FILM_IS, SWITCH_IS, FAULT_IS, RESET_BY, HANG,
                      CLOCK = 16, SLIP, WAIT };

// What happens, and the time until the next. The values: a command's fields; RAW: format, number of
// bytes; GARBAGE: seed; STREAM: velocity, validity, interval in ms; FILM_IS: counts of a half ms, -1
// for the finger's, and ms in which it goes there; SWITCH_IS: -1, 0, 1; FAULT_IS: 0, 1; RESET_BY: cause, bootloader's
// ms, torn memory; CLOCK: us, ms; SLIP: steps by which the tip is further inward than it counts.
struct Action {
  int32_t kind, wait_ms;
  int64_t values[10];
};

// Where the tip is at power-up, where the finger is, and how the board is wired.
struct Setting {
  double start_mm, touch_mm;
  int32_t inverted, normally_closed, fault_pin, film_falls;
};

enum Rule : int32_t {
  NO_RULE, BEYOND_HIGHEST, BELOW_LOWEST, MISCOUNTED, MOVES_AT_REST, MOVES_UNTOLD, TURNS_BACK,
  SEARCHES_TOO_FAR, SEARCHES_TOO_LONG, STAYS_SILENT, FORGOTTEN_ARMED, IGNORES_FILM, IGNORES_JUMP,
  IGNORES_FAULT_PIN, IGNORES_SWITCH, STALE_INPUT, TRIPS_WITHOUT_CAUSE, WRONG_TRANSITION,
  WRONG_ANSWER, NO_ANSWER, WRONG_SEQUENCE, CLAIMS_WITHDRAWN, OFF_WHILE_OUT, LATE_WITHDRAWAL,
  MOTOR_PIN, BACK_WITHOUT_RISE, AWAY_WITHOUT_FALL, SEARCH_PRESSES, SEARCH_LEAVES_PRESSED,
  WRONG_HOME, RESET_WITHOUT_WITHDRAWAL, HANGS
};

const int LONGEST_SCRIPT = 64;

struct Finding {
  int32_t rule, actions;
  int64_t board_ms;
  Setting setting;
  char text[200];
  Action script[LONGEST_SCRIPT];
};

// ---- The checks --------------------------------------------------------------------------------

// As PROTOCOL.md states them, once more.
const uint32_t ON_STATES = 1 << ARMED | 1 << HOMING | 1 << READY | 1 << RUNNING |
                           1 << WITHDRAWING | 1 << WITHDRAWN;
const uint32_t TRIP_STATES = 1 << HOMING | 1 << READY | 1 << RUNNING;
// A half millisecond's and a computation's steps, from what was read until it acts.
const int REACTION_STEPS = 34;
const int ANSWERED_MS = 5, NOTICED_MS = 4, FILM_SEEN_MS = 12, SETTLED_MS = 4;
const int FILM_NOISE = 64;
const int64_t RANGE = 1 << 28;
const double STIFFEST_N_PER_M = 1000, NOISE_N = 0.02;

struct Awaited {
  uint16_t number;
  uint8_t format, result, field;
  int halves;
};

struct Checker {
  Setting setting;
  int32_t rule;
  char text[200];
  int64_t ms;

  // Steps as the sketch counts directions; of home, and of the last time that it was known.
  int64_t net, zero, kept_zero, last_net;
  bool known, kept_known;
  int64_t rest_steps;

  // The limits, and the search, that were accepted.
  bool has_limits, reversed, by_search;
  int resets;
  Limits limits;
  Search search;

  // Since the last sign of life; since arm; film, fault pin and switch.
  int64_t life_ms, valid_ms, armed_ms, search_ms, ended_ms, ready_ms, film_ms, fault_ms, closed_ms, since_closed_ms;
  int64_t jumped_ms, open_ms, film_ok_ms;
  bool stuck, film_given, slipped;
  // Counts of a half ms that are given, and where they go to, -1: the finger's.
  int32_t film_half, film_goal, film_change;
  uint32_t noise;

  // Of a search.
  int64_t start_net, least_net;
  bool was_seeking, recorded;
  double start_n, most_n;
  // Pressed: counts of the film, as they rise with the force.
  int32_t film_began, film_least, film_last;
  int32_t films[FILM_SEEN_MS];

  // Of a withdrawal.
  bool leaving, full, disarmed, closed_meanwhile, from_search;
  int64_t trip_net, inward_steps, withdrawing_ms, most_withdrawing_ms;

  // The command on the line, and the answers to come, in their order.
  bool sent, was_sent;
  uint8_t format, result, field;
  uint16_t number;
  int64_t values[10];
  Awaited awaited[8];
  int awaited_count;
};

static Checker *const c = (Checker *)calloc(1, sizeof(Checker));

static void fail(Rule rule, const char *format, ...) {
  if (c->rule) return;
  c->rule = rule;
  va_list arguments;
  va_start(arguments, format);
  vsnprintf(c->text, sizeof c->text, format, arguments);
  va_end(arguments);
}

static bool in(uint32_t states, int which) { return states >> which & 1; }

static long position_by_pins() { return (long)(c->net - c->zero); }

static bool film_checked() {
  return c->has_limits && (c->limits.film_least || c->limits.film_most <= FILM_FULL_SCALE);
}

static int32_t pressed_film() {
  int32_t counts = world.film_halves[0] + world.film_halves[1];
  return c->limits.options & FILM_FALLS ? -counts : counts;
}

static int32_t film_share() {
  return std::max((c->limits.film_most - c->limits.film_least) / 64, 1);
}

static bool is_closed() { return pin_home() == !!(c->limits.options & NORMALLY_CLOSED); }

static inline void watched_step(struct mechanics *m, int direction) {
  int by = world.direction_pin == inward_level ? 1 : -1;
  c->net += by;
  long at = position_by_pins();
  if (c->known && by > 0 && at > c->limits.highest)
    fail(BEYOND_HIGHEST, "a step to %ld beyond %d", at, c->limits.highest);
  if (c->known && by < 0 && at < c->limits.lowest && in(1 << READY | 1 << RUNNING, state))
    fail(BELOW_LOWEST, "a step to %ld below %d", at, c->limits.lowest);
  if (in(1 << ARMED | 1 << WITHDRAWN, state) && ++c->rest_steps > 1)
    fail(MOVES_AT_REST, "a step in state %d", state);
  if (state == WITHDRAWING && c->leaving && by > 0 && c->withdrawing_ms >= 0 &&
      ++c->inward_steps > 1)
    fail(TURNS_BACK, "a step towards the finger in a withdrawal");
  if (state == HOMING && c->recorded) {
    c->least_net = std::min(c->least_net, c->net);
    if (c->net < c->start_net - c->search.distance - 1)
      fail(SEARCHES_TOO_FAR, "a search of more than %u steps", c->search.distance);
    if (c->net > c->least_net + c->search.opening + 1)
      fail(SEARCHES_TOO_FAR, "more than %u steps towards the finger", c->search.opening);
  }
  mechanics_step(m, direction);
}

// Return the field that is out of bounds, from 1; 0 for none.
static int wrong_field(const int64_t *v, uint8_t command) {
  if (command == LIMITS) {
    const int64_t least[] = {-RANGE, 1, 1000, 10, 0, 0, 1, std::max<int64_t>(10, v[6] / 2), 10, 0};
    const int64_t most[] = {0,     RANGE, 100000000, TICK_HZ, v[5] - 1, FILM_FULL_SCALE + 1,
                            RANGE, std::min(v[2], v[3]), 500, 31};
    for (int i = 0; i < 10; i++)
      if (v[i] < least[i] || v[i] > most[i]) return i + 1;
    return 0;
  }
  const Limits &l = c->limits;
  const int64_t travel = (int64_t)l.highest - l.lowest;
  const int64_t least[] = {v[0] ? 10 : 0, 0, 1, 1};
  const int64_t most[] = {l.highest_rate, 2 * travel, l.highest / 2, 60000};
  for (int i = 0; i < 4; i++)
    if (v[i] < least[i] || v[i] > most[i]) return i + 1;
  return 0;
}

// A command is taken in a state: set the answer, and return the states that it may lead to.
static uint32_t take(int before, bool outside) {
  uint32_t stay = 1u << before;
  c->result = DONE;
  c->field = 0;
  auto refuse = [&](uint8_t result, int field) {
    c->result = result;
    c->field = field;
    return stay;
  };
  switch (c->format) {
  case GREET:
    return stay;
  case VELOCITY:
    if (!in(TRIP_STATES, before) || c->values[1] < 1 || c->values[1] > 1000)
      return refuse(WRONG_STATE, 0);
    c->life_ms = 0;
    c->valid_ms = c->values[1];
    return before == READY ? 1 << RUNNING : stay;
  case HOME:
    if (before != ARMED) return refuse(WRONG_STATE, 0);
    if (int wrong = wrong_field(c->values, HOME)) return refuse(OUT_OF_BOUNDS, wrong);
    if (outside) return refuse(FILM_OUTSIDE, 0);
    c->search = {(uint32_t)c->values[0], (uint32_t)c->values[1], (uint32_t)c->values[2],
                 (uint16_t)c->values[3]};
    c->life_ms = c->search_ms = 0;
    c->by_search = c->search.rate;
    return c->search.rate ? 1 << HOMING : 1 << READY;
  case LIMITS:
    if (before != DISARMED) return refuse(WRONG_STATE, 0);
    if (int wrong = wrong_field(c->values, LIMITS)) return refuse(OUT_OF_BOUNDS, wrong);
    c->limits = {(int32_t)c->values[0],  (int32_t)c->values[1],  (uint32_t)c->values[2],
                 (uint32_t)c->values[3], (uint16_t)c->values[4], (uint16_t)c->values[5],
                 (uint32_t)c->values[6], (uint32_t)c->values[7], (uint16_t)c->values[8],
                 (uint8_t)c->values[9]};
    c->has_limits = true;
    // Read at once, with the new options.
    c->closed_ms = is_closed() ? DEBOUNCE_MS : 0;
    c->open_ms = is_closed() ? 0 : DEBOUNCE_MS;
    c->since_closed_ms = is_closed() ? 0 : INT32_MAX;
    return stay;
  case ARM:
    if (!c->has_limits) return refuse(NO_LIMITS, 0);
    return before == DISARMED ? 1 << ARMED : refuse(WRONG_STATE, 0);
  case DISARM:
    return in(TRIP_STATES | 1 << WITHDRAWING, before) ? 1 << WITHDRAWING | 1 << DISARMED
                                                      : 1 << DISARMED;
  case CLEAR:
    return in(1 << WITHDRAWN | 1 << FAULT, before) ? 1 << DISARMED : refuse(WRONG_STATE, 0);
  case WITHDRAW:
    if (!in(TRIP_STATES, before)) return refuse(WRONG_STATE, 0);
    return before == HOMING ? 1 << WITHDRAWING | 1 << FAULT : 1 << WITHDRAWING;
  }
  return refuse(UNKNOWN, 0);
}

// The states that a millisecond without a command may lead to.
static uint32_t follow_up(uint32_t states) {
  const uint32_t next[] = {
      1 << DISARMED,
      1 << ARMED | 1 << FAULT,
      1 << HOMING | 1 << READY | 1 << WITHDRAWING | 1 << WITHDRAWN | 1 << FAULT,
      1 << READY | 1 << WITHDRAWING | 1 << WITHDRAWN,
      1 << RUNNING | 1 << WITHDRAWING | 1 << WITHDRAWN,
      1 << WITHDRAWING | 1 << WITHDRAWN | 1 << DISARMED | 1 << FAULT,
      1 << WITHDRAWN,
      1 << FAULT,
  };
  uint32_t after = 0;
  for (int each = 0; each < 8; each++)
    if (in(states, each)) after |= next[each];
  return after;
}

static void begin_withdrawal(int64_t before_net, bool leaves, bool is_full) {
  c->leaving = leaves;
  c->full = is_full;
  c->closed_meanwhile = false;
  c->trip_net = std::max(before_net, c->net);
  c->inward_steps = c->withdrawing_ms = 0;
  const Limits &l = c->limits;
  double way = std::max<double>(l.withdrawal, l.highest);
  if (c->known) way = std::max<double>(l.withdrawal, position_by_pins());
  if (!leaves) way = 2.0 * ((double)l.highest - l.lowest);
  double rate = l.withdrawal_rate, ramp_s = (double)l.highest_rate / l.acceleration;
  c->most_withdrawing_ms = (int64_t)fmin(1e12, 1.2e3 * (way / rate + 2 * ramp_s) + 100);
}

// A board that leaves a state by itself has the cause that it states. Its inputs are a millisecond
// newer than what is recorded, and another half of the film may have come since.
static bool is_cause_there(int before) {
  const Limits &l = c->limits;
  bool out = c->film_ms;
  for (uint16_t half : world.film_halves)
    out |= 2 * half < l.film_least + FILM_NOISE || 2 * half + FILM_NOISE >= l.film_most;
  int32_t film = pressed_film();
  int32_t highest = std::max(film, *std::max_element(c->films, c->films + FILM_SEEN_MS));
  bool homing = before == HOMING || before == ARMED;
  switch (cause) {
  case SILENCE:
    if (before == ARMED && !c->recorded) return c->armed_ms >= ARMED_MS - 1;
    return c->life_ms >= l.watchdog_ms - 1;
  case FILM:
    return out || (homing && film_checked() && abs(film - c->film_last) + FILM_NOISE >= 4 * film_share());
  case FAULT_PIN:
    return (l.options & HAS_FAULT_PIN) && pin_fault() == !!(l.options & FAULT_IS_HIGH);
  case HOME_SWITCH:
    return before == RUNNING && c->since_closed_ms <= DEBOUNCE_MS + 1 &&
           position_by_pins() > (int64_t)c->search.opening - REACTION_STEPS;
  case NO_HOME:
    return homing && c->net <= c->start_net - c->search.distance + 1;
  case STUCK_SWITCH:
    return homing && !c->was_seeking && c->net >= c->start_net + c->search.opening - 1;
  case HOMING_TIMEOUT:
    return homing && c->search_ms >= c->search.timeout_ms - 1;
  case PRESSED:
    return homing && film_checked() && highest + FILM_NOISE >= c->film_least + 4 * film_share();
  default:
    return false;
  }
}

// A part of the way that a search has gone: only back where it was, only away where it leaves.
static void check_search_end(int before, bool began_search) {
  if (before != HOMING || state == HOMING || state == READY || began_search) return;
  // The last ones do not count, as a wire may have been torn off.
  int32_t *end = c->films + FILM_SEEN_MS - SETTLED_MS + 1;
  int32_t last_least = *std::min_element(c->films, end);
  int32_t last_most = *std::max_element(c->films, end);
  if (state != WITHDRAWING) return;
  if (leaving && (!c->was_seeking || !film_checked() ||
                  last_least > c->film_began - film_share()))
    fail(AWAY_WITHOUT_FALL, "a withdrawal of a search, whose film has not fallen");
  if (!leaving && c->was_seeking &&
      (!film_checked() || last_most < c->film_least + film_share()))
    fail(BACK_WITHOUT_RISE, "back to where a search began, whose film has not risen");
}

static void check_rest_after_search() {
  int64_t most = c->was_seeking ? c->start_net : c->least_net;
  if (c->net > most + 1)
    fail(SEARCH_LEAVES_PRESSED, "%ld steps further than the search began", (long)(c->net - most));
  bool honest = !c->slipped;
  double now_n = world.mechanics.force_n;
  double step_n = STIFFEST_N_PER_M * world.mechanics.step_m;
  if (honest && !c->reversed && now_n > c->start_n + 2 * step_n)
    fail(SEARCH_LEAVES_PRESSED, "%.3f N after a search from %.3f N", now_n, c->start_n);
  bool signed_right = c->setting.film_falls == !!(c->limits.options & FILM_FALLS);
  if (honest && c->reversed && film_checked() && !c->film_given && signed_right) {
    double share_n = film_share() / (1024 * 16 / 5.0 * 0.51);
    double late_n = step_n * c->search.rate * FILM_SEEN_MS * 1e-3;
    if (now_n > c->start_n + share_n + late_n + NOISE_N)
      fail(SEARCH_LEAVES_PRESSED, "%.3f N after a reversed search from %.3f N", now_n, c->start_n);
    if (c->most_n > c->start_n + 4 * share_n + late_n + NOISE_N)
      fail(SEARCH_PRESSES, "%.3f N in a reversed search from %.3f N", c->most_n, c->start_n);
  }
}

static bool has_left() {
  return c->trip_net - c->net >= (int64_t)c->limits.withdrawal - REACTION_STEPS;
}

static bool is_home() {
  if (c->known) return position_by_pins() <= 1;
  return !c->kept_known || c->net - c->kept_zero <= 1 + c->resets;
}

static void check_withdrawn() {
  if (!is_home() || !(has_left() || c->closed_meanwhile))
    fail(CLAIMS_WITHDRAWN, "withdrawn after %ld steps, at %ld", (long)(c->trip_net - c->net),
         (long)(c->net - (c->known ? c->zero : c->kept_zero)));
  if (world.mechanics.force_n > 0 && c->by_search && !c->slipped && !c->stuck && !c->reversed &&
      (c->known || c->kept_known))
    fail(CLAIMS_WITHDRAWN, "withdrawn with %.3f N", world.mechanics.force_n);
}

// A change of state, and what holds at its end.
static void check_state(int before, int64_t before_net, uint32_t allowed, bool disarm) {
  int after = state;
  bool was_withdrawing = before == WITHDRAWING;
  if (!in(follow_up(allowed), after)) {
    fail(WRONG_TRANSITION, "from state %d to %d after format %d", before, after,
         c->sent ? c->format : 0);
    return;
  }
  if (in(ON_STATES, after) != world.motor_on)
    fail(MOTOR_PIN, "state %d with the motor %s", after, world.motor_on ? "on" : "off");
  // Where a withdrawal begins, it may end at once.
  const uint32_t ways = 1 << WITHDRAWING | 1 << WITHDRAWN;
  bool begins = !in(ways, before) && in(ways, after);
  begins |= in(1 << READY | 1 << RUNNING, before) && after == DISARMED;
  if (begins) {
    c->from_search = before == HOMING || (before == ARMED && c->by_search);
    begin_withdrawal(before_net, !c->from_search || leaving, !disarm);
    c->disarmed = disarm;
  } else if (was_withdrawing && disarm) {
    c->disarmed = true;
  }
  if (c->since_closed_ms <= DEBOUNCE_MS) c->closed_meanwhile = true;
  if (after == WITHDRAWN && (before != WITHDRAWN)) {
    if (!c->leaving || c->disarmed) fail(WRONG_TRANSITION, "withdrawn from a way back");
    check_withdrawn();
  }
  bool ends = in(1 << DISARMED | 1 << FAULT, after) && after != before;
  if (ends && (was_withdrawing || begins)) {
    if (after == DISARMED && !c->disarmed) fail(WRONG_TRANSITION, "off without a command");
    if (after == FAULT && (c->leaving || c->disarmed)) fail(WRONG_TRANSITION, "a fault");
    if (c->leaving && (!is_home() || (c->full && !has_left() && !c->closed_meanwhile)))
      fail(OFF_WHILE_OUT, "off after %ld steps, at %ld", (long)(c->trip_net - c->net),
           (long)(c->net - (c->known ? c->zero : c->kept_zero)));
  }
  if (ends && (before == HOMING || (was_withdrawing && c->from_search && !c->leaving)))
    check_rest_after_search();
  bool by_host = c->was_sent && (c->format == DISARM || c->format == WITHDRAW);
  if ((begins && after != DISARMED) || (after == FAULT && in(1 << ARMED | 1 << HOMING, before))) {
    bool is_there = by_host && cause == HOST;
    if (!is_there && !is_cause_there(before))
      fail(TRIPS_WITHOUT_CAUSE, "from state %d to %d with cause %d", before, after, cause);
  }
  if (after == DISARMED && cause != NONE) fail(TRIPS_WITHOUT_CAUSE, "disarmed by %d", cause);
  if (after != before && in(1 << ARMED | 1 << WITHDRAWN, after)) c->rest_steps = 0;
  if (after == ARMED && before != ARMED) {
    c->armed_ms = 0;
    c->kept_known = false;
    c->reversed = (world.inverted != 0) != !!(c->limits.options & INVERTED);
  }
}

// The sketch's reading at a search's begin is that of the last millisecond, or of this one.
static void begin_search_record() {
  c->start_net = c->least_net = c->net;
  c->start_n = c->most_n = world.mechanics.force_n;
  int32_t present = pressed_film();
  c->film_began = std::max(c->film_last, present);
  c->film_least = std::min(c->film_last, present);
  c->was_seeking = c->recorded = true;
  std::fill(c->films, c->films + FILM_SEEN_MS, present);
}

// What must be noticed, each millisecond.
static void check_inputs() {
  c->life_ms++;
  c->armed_ms++;
  c->search_ms++;
  const Limits &l = c->limits;
  bool closed = is_closed();
  c->closed_ms = closed ? c->closed_ms + 1 : 0;
  c->open_ms = closed ? 0 : c->open_ms + 1;
  c->since_closed_ms = c->closed_ms >= DEBOUNCE_MS - 1 ? 0 : c->since_closed_ms + 1;
  bool out = false;
  for (uint16_t half : world.film_halves)
    out |= 2 * half < l.film_least || 2 * half >= l.film_most;
  c->film_ms = out ? c->film_ms + 1 : 0;
  bool ok = !out;
  for (uint16_t half : world.film_halves)
    ok &= 2 * half >= l.film_least + FILM_NOISE && 2 * half + FILM_NOISE < l.film_most;
  c->film_ok_ms = ok ? c->film_ok_ms + 1 : 0;
  bool fault = (l.options & HAS_FAULT_PIN) && pin_fault() == !!(l.options & FAULT_IS_HIGH);
  c->fault_ms = fault ? c->fault_ms + 1 : 0;
  int32_t change = abs(pressed_film() - c->film_last);
  c->jumped_ms = state == HOMING && film_checked() && (c->jumped_ms || change > 4 * film_share() + FILM_NOISE)
                     ? c->jumped_ms + 1
                     : 0;
  if (world.hung) return;
  if (c->jumped_ms > NOTICED_MS) fail(IGNORES_JUMP, "a search goes on after the film's jump");
  if (std::max(c->closed_ms, c->open_ms) > DEBOUNCE_MS + NOTICED_MS && closed != home_closed)
    fail(STALE_INPUT, "the switch is %s", closed ? "closed" : "open");
  if (film_outside ? c->film_ok_ms > NOTICED_MS || !c->has_limits
                   : c->film_ms > NOTICED_MS && c->has_limits)
    fail(STALE_INPUT, "the film is %s", film_outside ? "inside" : "outside");
  int64_t steps = c->net - c->last_net;
  c->last_net = c->net;
  double ramp_ms = 1e3 / std::max<double>(l.acceleration, 1000);
  c->ready_ms = state == READY ? c->ready_ms + 1 : 0;
  if (steps && c->ready_ms > ramp_ms * c->search.rate / 8 + NOTICED_MS)
    fail(MOVES_UNTOLD, "%ld steps before the first velocity", (long)steps);
  if (steps && state == RUNNING &&
      c->life_ms > c->valid_ms + ramp_ms * l.highest_rate + NOTICED_MS)
    fail(MOVES_UNTOLD, "%ld steps after %ld ms without a velocity", (long)steps, (long)c->life_ms);
  bool ended = c->was_seeking ? c->net <= c->start_net - c->search.distance
                              : c->net >= c->start_net + c->search.opening;
  c->ended_ms = state == HOMING && ended && !closed == c->was_seeking ? c->ended_ms + 1 : 0;
  if (c->ended_ms > DEBOUNCE_MS + NOTICED_MS ||
      (state == HOMING && c->search_ms > c->search.timeout_ms + NOTICED_MS))
    fail(SEARCHES_TOO_LONG, "a search of %ld ms", (long)c->search_ms);
  if (state == ARMED && c->armed_ms > ARMED_MS + NOTICED_MS)
    fail(FORGOTTEN_ARMED, "armed for %ld ms", (long)c->armed_ms);
  if (in(TRIP_STATES, state)) {
    if (c->life_ms > l.watchdog_ms + NOTICED_MS)
      fail(STAYS_SILENT, "silence of %ld ms in state %d", (long)c->life_ms, state);
    if (c->film_ms > NOTICED_MS) fail(IGNORES_FILM, "film outside its limits in state %d", state);
    if (c->fault_ms > NOTICED_MS) fail(IGNORES_FAULT_PIN, "fault pin in state %d", state);
  }
  if (state == RUNNING && c->known && c->closed_ms > DEBOUNCE_MS + NOTICED_MS &&
      position_by_pins() > (int64_t)c->search.opening + REACTION_STEPS * NOTICED_MS)
    fail(IGNORES_SWITCH, "switch closed at %ld", position_by_pins());
  if (state == WITHDRAWING && ++c->withdrawing_ms > c->most_withdrawing_ms)
    fail(LATE_WITHDRAWAL, "a withdrawal of more than %ld ms", (long)c->most_withdrawing_ms);
  if (state == HOMING || (state == WITHDRAWING && c->from_search))
    c->most_n = fmax(c->most_n, world.mechanics.force_n);
  if (state == HOMING) {
    if (c->was_seeking && !seeking) {
      begin_search_record();
      c->was_seeking = false;
    }
    c->film_least = std::min(c->film_least, pressed_film());
  }
  memmove(c->films, c->films + 1, sizeof c->films - sizeof *c->films);
  c->films[FILM_SEEN_MS - 1] = c->film_last = pressed_film();
}

static void check_count() {
  long counted = stepper.position + (int16_t)(uint16_t)(tick_steps - stepper.counted_steps);
  if (tick_step) counted -= world.direction_pin == inward_level ? 1 : -1;
  if (homed && !c->known && in(ON_STATES, state)) {
    c->known = true;
    c->zero = c->kept_zero = c->net - counted;
    c->kept_known = true;
    double home_steps = (world.mechanics.tip_m + 1e-3 * c->setting.touch_mm) /
                        world.mechanics.step_m - counted;
    double late = c->search.rate / 8.0 * 5e-3 + 3;
    if (c->by_search && !c->stuck && !c->slipped && !c->reversed && fabs(home_steps) > late &&
        c->setting.normally_closed == !!(c->limits.options & NORMALLY_CLOSED))
      fail(WRONG_HOME, "home is %.0f steps from the switch", home_steps);
  }
  if (!homed) c->known = false;
  if (c->known && counted != position_by_pins())
    fail(MISCOUNTED, "counted %ld, given %ld", counted, position_by_pins());
}

static void check_answer(const uint8_t *encoded, int length) {
  uint8_t body[32];
  int bytes = 0;
  for (int at = 0; at < length && bytes < 30;) {
    int code = encoded[at++];
    for (int i = 1; i < code && at < length; i++) body[bytes++] = encoded[at++];
    if (at < length) body[bytes++] = 0;
  }
  if (body[0] != ANSWER) return;
  uint16_t number = body[1] | body[2] << 8;
  const Awaited &first = c->awaited[0];
  if (!c->awaited_count || number != first.number || body[4] != first.result ||
      body[5] != first.field) {
    fail(WRONG_ANSWER, "answer %d, field %d to format %d, not %d, field %d", body[4], body[5],
         body[3], first.result, first.field);
    return;
  }
  std::copy(c->awaited + 1, c->awaited + c->awaited_count--, c->awaited);
}

static void take_what_was_sent() {
  static uint8_t frame[96];
  static int length = 0;
  while (world.taken.count) {
    uint8_t byte = world.taken.take();
    if (byte) {
      if (length < 95) frame[length++] = byte;
      continue;
    }
    // A state's length; none else is as long.
    if (length && length != STATE_BYTES - 1) check_answer(frame, length);
    length = 0;
  }
}

// A reset has happened, and setup() has run unless a bootloader waits.
static void check_reset(int before, uint8_t by) {
  bool goes_on = in(1 << READY | 1 << RUNNING, before) || (before == WITHDRAWING && c->leaving);
  bool must = goes_on && by != RESET_POWER_UP;
  if (!c->kept_known || !must || (before == WITHDRAWING && c->from_search)) c->kept_known = false;
  c->known = c->has_limits = c->sent = c->disarmed = false;
  c->resets++;
  c->awaited_count = 0;
  c->closed_ms = c->open_ms = c->jumped_ms = 0;
  if (!must) c->limits = {};
  world.taken.count = 0;
  if (must != (state == WITHDRAWING) || (!must && state != DISARMED)) {
    fail(RESET_WITHOUT_WITHDRAWAL, "state %d after a reset in state %d", state, before);
  }
  if (state != WITHDRAWING) return;
  c->withdrawing_ms = -1;
  begin_withdrawal(c->net, true, true);
}

// The state at a reset, whose bootloader waits.
static int waiting_for_start;

// The finger's film, or what is given in its place.
static void set_film() {
  double volts = 2.5 + (c->setting.film_falls ? -0.51 : 0.51) * world.mechanics.force_n;
  int32_t most = FILM_FULL_SCALE / 2, counts = volts / 5 * 8 * 1024;
  counts = std::min(std::max(counts, 0), most);
  if (c->film_goal < 0) {
    c->film_half = counts;
    for (int32_t &half : world.given_film) {
      c->noise = c->noise * 1664525u + 1013904223u;
      half = std::min(std::max(counts + (int32_t)(c->noise >> 29) - 4, 0), most);
    }
    return;
  }
  int32_t left = c->film_goal - c->film_half;
  c->film_half += std::min(std::max(left, -c->film_change), c->film_change);
  world.given_film[0] = world.given_film[1] = c->film_half;
}

// Let loop() pass once: it takes a command at most, and then does what a millisecond needs.
static void pass_checked_loop() {
  int before = state;
  int64_t before_net = c->net;
  bool was_outside = film_outside;
  uint16_t was_sequence = sequence;
  world.guarded = 0;
  loop();
  uint32_t allowed = 1u << before;
  bool began_search = false, disarm = false;
  uint16_t number = was_sequence;
  c->was_sent = false;
  if (c->sent && !world.fed.count && !world.received.count) {
    allowed = take(before, was_outside);
    c->sent = false;
    bool taken = c->result == DONE;
    c->was_sent = taken;
    if (taken) number = c->number;
    disarm = taken && c->format == DISARM;
    began_search = taken && c->format == HOME && c->search.rate;
    if (c->format != VELOCITY && c->format != GREET)
      c->awaited[c->awaited_count++] = {c->number, c->format, c->result, c->field, 0};
  }
  if (began_search) begin_search_record();
  check_count();
  check_search_end(before, began_search);
  check_state(before, before_net, allowed, disarm);
  if (sequence != number)
    fail(WRONG_SEQUENCE, "sequence %d and not %d, after format %d", sequence, number, c->format);
  c->recorded &= state == HOMING;
  if (state != WITHDRAWING) c->withdrawing_ms = -1;
}

// As pass_half() of host.cpp.
static void pass_checked_half() {
  int64_t was_ms = world.passed_ms;
  if (world.ticks < world.held_until) {
    int before_reset = waiting_for_start;
    wait_for_bootloader();
    c->ms++;
    if (world.ticks >= world.held_until) check_reset(before_reset, world.reset_cause);
    else if (world.motor_on) fail(MOTOR_PIN, "the motor is on in a bootloader");
    return;
  }
  set_film();
  do tick();
  while (ticks_left % HALF_MS_TICKS);
  if (!world.hung) {
    do pass_checked_loop();
    while (world.received.count);
  }
  c->ms += world.passed_ms - was_ms;
  if (world.ticks - world.alive_at > WATCHDOG_TICKS) {
    if (!world.hung) fail(HANGS, "a reset by the processor's watchdog");
    int before = state;
    world.hung = 0;
    host_reset(RESET_WATCHDOG, 0);
    check_reset(before, RESET_WATCHDOG);
    return;
  }
  for (int64_t passed = was_ms; passed < world.passed_ms; passed++) check_inputs();
  take_what_was_sent();
  for (int i = 0; i < c->awaited_count; i++)
    if (++c->awaited[i].halves > 2 * ANSWERED_MS)
      fail(NO_ANSWER, "no answer to format %d", c->awaited[i].format);
}

// ---- Playing -----------------------------------------------------------------------------------

static void begin(const Setting &setting) {
  memset(c, 0, sizeof *c);
  c->setting = setting;
  c->film_goal = -1;
  c->noise = 1;
  c->withdrawing_ms = -1;
  host_new();
  world.mechanics.rigid = 1;
  world.mechanics.start_mm = setting.start_mm;
  world.mechanics.touch_mm = setting.touch_mm;
  world.inverted = setting.inverted;
  world.normally_closed = setting.normally_closed;
  world.fault_pin = setting.fault_pin;
  host_film(8184 / 2, 8184 / 2);
  host_power_up();
}

static void put_frame(const uint8_t *body, int length) {
  FrameWriter frame;
  memcpy(frame.body, body, length);
  frame.length = length;
  uint8_t encoded[LARGEST_FRAME];
  host_feed(encoded, frame.encode(encoded));
}

static void send_command(uint8_t format, const int64_t *v, int raw_bytes) {
  static uint16_t number;
  // What does not run reads nothing, and its line is cleared by the reset.
  if (world.hung || world.ticks < world.held_until) return;
  uint8_t body[LARGEST_BODY];
  int length = 0;
  auto add = [&](int64_t value, int bytes) {
    for (int i = 0; i < bytes; i++) body[length++] = (uint8_t)(value >> 8 * i);
  };
  if (++number == sequence) number++;
  add(format, 1);
  add(number, 2);
  if (raw_bytes >= 0) {
    for (int i = 0; i < raw_bytes; i++) add(0, 1);
  } else if (format == VELOCITY) {
    add(v[0], 4);
    add(v[1], 2);
  } else if (format == HOME) {
    const int sizes[] = {4, 4, 4, 2};
    for (int i = 0; i < 4; i++) add(v[i], sizes[i]);
  } else if (format == LIMITS) {
    const int sizes[] = {4, 4, 4, 4, 2, 2, 4, 4, 2, 1};
    for (int i = 0; i < 10; i++) add(v[i], sizes[i]);
  }
  c->sent = true;
  c->format = raw_bytes < 0 ? format : 0;
  if (raw_bytes == 0 && format >= GREET && format <= WITHDRAW && format != VELOCITY &&
      format != HOME && format != LIMITS)
    c->format = format;
  c->number = number;
  memcpy(c->values, v, sizeof c->values);
  put_frame(body, length);
}

static void put_garbage(uint32_t seed) {
  if (world.hung || world.ticks < world.held_until) return;
  for (int i = 0; i < 20; i++) {
    seed = seed * 1664525u + 1013904223u;
    uint8_t byte = seed >> 24;
    host_feed(&byte, 1);
  }
  const uint8_t end[] = {1, 0};
  host_feed(end, sizeof end);
}

// At least until what was sent has arrived.
static void run_ms(int64_t ms) {
  for (int half = 0; c->sent && half < 4 && !c->rule; half++) pass_checked_half();
  for (int64_t until = c->ms + ms; c->ms < until && !c->rule;) pass_checked_half();
}

static void play(const Action &action) {
  const int64_t *v = action.values;
  switch (action.kind) {
  case RAW:
    send_command(v[0], v, v[1]);
    break;
  case GARBAGE:
    put_garbage(v[0]);
    break;
  case STREAM:
    for (int64_t until = c->ms + action.wait_ms; c->ms < until && !c->rule;) {
      int64_t next = c->ms + v[2];
      send_command(VELOCITY, v, -1);
      run_ms(0);
      run_ms(next - c->ms);
    }
    return;
  case FILM_IS:
    c->film_goal = v[0];
    c->film_change = v[1] ? FILM_FULL_SCALE / 4 / v[1] : FILM_FULL_SCALE;
    c->film_given |= v[0] >= 0;
    break;
  case SWITCH_IS:
    world.mechanics.stuck_switch = v[0];
    c->stuck |= v[0] >= 0;
    break;
  case FAULT_IS:
    world.fault = v[0];
    break;
  case RESET_BY: {
    int before = state;
    if (world.ticks < world.held_until) break;
    world.fed.count = 0;
    world.hung = 0;
    if (v[2]) kept.position -= 256;
    host_reset(v[0], v[1]);
    waiting_for_start = before;
    if (!v[1]) check_reset(before, v[0]);
    break;
  }
  case HANG:
    if (world.ticks >= world.held_until && !c->sent) world.hung = 1;
    break;
  case CLOCK:
    if (world.ticks >= world.held_until) host_set_clock(v[0], v[1]);
    break;
  case SLIP:
    world.mechanics.steps += v[0];
    world.mechanics.tip_m = world.mechanics.steps * world.mechanics.step_m;
    c->slipped = true;
    break;
  case WAIT:
    break;
  default:
    send_command(action.kind, v, -1);
  }
  int64_t until = c->ms + action.wait_ms;
  run_ms(0);
  run_ms(until - c->ms);
}

// Silence until the board rests.
static void end_script(int64_t most_ms) {
  for (int64_t until = c->ms + most_ms; c->ms < until && !c->rule;) {
    run_ms(10);
    if (in(1 << DISARMED | 1 << WITHDRAWN | 1 << FAULT, state) && world.ticks >= world.held_until)
      return;
  }
}

static bool found(Finding *finding, const Setting &setting, const Action *script, int count,
                  int64_t board_ms) {
  if (!c->rule) return false;
  finding->rule = c->rule;
  finding->actions = count;
  finding->board_ms = board_ms;
  finding->setting = setting;
  memcpy(finding->text, c->text, sizeof c->text);
  if (finding->script != script) std::copy(script, script + count, finding->script);
  return true;
}

const int64_t LAST_SILENCE_MS = 1500;

extern "C" __attribute__((visibility("default"))) int64_t search_play(
    const Setting *setting, const Action *script, int32_t count, Finding *finding) {
  begin(*setting);
  for (int i = 0; i < count && !c->rule; i++) play(script[i]);
  if (!c->rule) end_script(LAST_SILENCE_MS);
  finding->rule = NO_RULE;
  found(finding, *setting, script, count, c->ms);
  return c->ms;
}

// ---- At random ---------------------------------------------------------------------------------

struct Chance {
  uint64_t seed;

  uint64_t next() {
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return seed * 0x2545F4914F6CDD1Dull >> 16;
  }
  int below(int count) { return next() % count; }
  bool one_in(int count) { return !below(count); }
  template <size_t COUNT> int64_t of(const int64_t (&values)[COUNT]) {
    return values[below(COUNT)];
  }
};

static const int64_t USUAL_LIMITS[] = {0, 4000, 10000000, 32000, 500, 13000, 3000, 16000, 50, 0};
// From home to a finger, and back, in some 20 ms.
static const int64_t QUICK_LIMITS[] = {0, 600, 10000000, 32000, 500, 13000, 300, 32000, 10, 0};
static const int64_t QUICK_SEARCH[] = {16000, 900, 100, 3000};
const double QUICK_TOUCH_MM = 0.25;

static Action command(int kind, int wait_ms, const int64_t *values, int count) {
  Action action = {kind, wait_ms, {}};
  std::copy(values, values + count, action.values);
  return action;
}

static Action random_limits(Chance &chance, const Setting &setting) {
  Action action = chance.one_in(3) ? command(LIMITS, 1, USUAL_LIMITS, 10)
                                   : command(LIMITS, 1, QUICK_LIMITS, 10);
  action.wait_ms = chance.below(4);
  int64_t *v = action.values;
  if (setting.inverted) v[9] |= INVERTED;
  if (setting.normally_closed) v[9] |= NORMALLY_CLOSED;
  if (setting.fault_pin) v[9] |= HAS_FAULT_PIN;
  if (setting.fault_pin == 2) v[9] |= FAULT_IS_HIGH;
  if (setting.film_falls) v[9] |= FILM_FALLS;
  if (chance.one_in(4)) {
    // The film is not connected; or its limits are those of the class bench.
    v[4] = chance.one_in(2) ? 0 : 4588;
    v[5] = v[4] ? 11796 : FILM_FULL_SCALE + 1;
  }
  if (chance.one_in(8)) v[9] ^= INVERTED;
  if (!chance.one_in(3)) return action;
  for (int changes = 1 + chance.below(2); changes; changes--) {
    int which = chance.below(10);
    const int64_t values[10][6] = {
        {0, -1, -200, -RANGE, 1, INT32_MIN},
        {1, 2, 600, RANGE, 0, RANGE + 1},
        {1000, 32000, 1000000, 100000000, 999, 100000001},
        {10, 1000, 32000, 20000, 9, 32001},
        {0, 8000, 8183, 8100, 16369, 12999},
        {16369, 8300, 8200, 16368, 16370, 501},
        {1, 30, 3000, RANGE, 0, 64000},
        {10, 150, 1500, 32000, 9, 32001},
        {10, 11, 50, 500, 9, 501},
        {0, 1, 16, 31, 32, 255},
    };
    v[which] = chance.of(values[which]);
  }
  return action;
}

static Action random_home(Chance &chance) {
  Action action = command(HOME, 1, QUICK_SEARCH, 4);
  int64_t *v = action.values;
  if (chance.one_in(4)) v[0] = 0;
  if (chance.one_in(3)) v[0] = chance.of({10, 800, 8000, 32000, 9, 32001, 0});
  int64_t travel = (int64_t)c->limits.highest - c->limits.lowest;
  if (chance.one_in(2)) {
    v[1] = chance.of({travel, 2 * travel, 2 * travel + 1, 0, 1, 30, UINT32_MAX});
  } else {
    v[1] = std::min<int64_t>(UINT32_MAX, 2 * travel);
  }
  v[2] = std::min<int64_t>(v[2], c->limits.highest / 2);
  if (chance.one_in(4))
    v[2] = chance.of({1, c->limits.highest / 2, c->limits.highest / 2 + 1, 0, UINT32_MAX, 30});
  if (chance.one_in(8)) v[3] = chance.of({1, 30, 60000, 0, 60001, 65535});
  action.wait_ms = chance.of({1, 1, 3, 10});
  return action;
}

static void random_velocity(Chance &chance, int64_t *v) {
  v[0] = chance.of({0, 1, -1, 256 * 1000, -256 * 1000, 256 * 8000, 256 * 32000, -256 * 32000,
                    256 * 12000, INT32_MAX, INT32_MIN, 256 * 20000});
  v[1] = chance.of({5, 20, 20, 20, 50, 1, 500, 1000, 0, 1001, 65535});
}

static Action random_stream(Chance &chance) {
  Action action = {STREAM, (int32_t)chance.of({4, 20, 60, 150, 400}), {}};
  random_velocity(chance, action.values);
  if (chance.one_in(2)) action.values[0] = 256 * 20000;
  action.values[1] = chance.of({5, 20, 20, 1});
  action.values[2] = chance.of({1, 2, 2, 5});
  return action;
}

// The command that a usual host sends next.
static Action next_of_host(Chance &chance, const Setting &setting) {
  switch (state) {
  case DISARMED:
    if (!has_limits || chance.one_in(3)) return random_limits(chance, setting);
    return {ARM, chance.below(3), {}};
  case ARMED:
    return random_home(chance);
  case HOMING: {
    Action action = random_stream(chance);
    action.values[0] = 0;
    return action;
  }
  case READY:
  case RUNNING:
    return random_stream(chance);
  case WITHDRAWING:
    return {WAIT, (int32_t)chance.of({1, 5, 30, 200}), {}};
  default:
    return {chance.one_in(2) ? CLEAR : DISARM, 1, {}};
  }
}

static Action random_action(Chance &chance, const Setting &setting) {
  if (!chance.one_in(3)) return next_of_host(chance, setting);
  Action action = {WAIT, (int32_t)chance.of({0, 1, 1, 2, 5, 12, 30}), {}};
  int64_t *v = action.values;
  switch (chance.below(24)) {
  case 0: {
    Action limited = random_limits(chance, setting);
    return limited;
  }
  case 1:
    return random_home(chance);
  case 2:
  case 3:
    action.kind = VELOCITY;
    random_velocity(chance, v);
    break;
  case 4:
    action.kind = ARM;
    break;
  case 5:
  case 6:
    action.kind = DISARM;
    break;
  case 7:
    action.kind = CLEAR;
    break;
  case 8:
    action.kind = WITHDRAW;
    break;
  case 9:
    action.kind = GREET;
    break;
  case 10:
    action.kind = RAW;
    v[0] = chance.below(256);
    v[1] = chance.of({0, 0, 1, 6, 14, 34, 40});
    // One that a command has is that command.
    if ((v[0] == VELOCITY && v[1] == 6) || (v[0] == HOME && v[1] == 14)) v[1]++;
    break;
  case 11:
    action.kind = GARBAGE;
    v[0] = chance.next();
    break;
  case 12:
  case 13:
    action.kind = FILM_IS;
    v[0] = chance.of({0, 8184, 4092, 3000, 250, 6600, 4400, 5000});
    v[1] = chance.of({0, 0, 3, 10, 100});
    if (chance.one_in(3)) v[0] = -1;
    break;
  case 14:
    action.kind = SWITCH_IS;
    v[0] = chance.below(3) - 1;
    break;
  case 15:
    action.kind = FAULT_IS;
    v[0] = chance.below(2);
    break;
  case 16:
  case 17:
    action.kind = RESET_BY;
    v[0] = chance.below(5);
    v[1] = chance.one_in(4) ? chance.of({1, 20, 100}) : 0;
    v[2] = chance.one_in(8);
    break;
  case 18:
    action.kind = HANG;
    action.wait_ms = 40;
    break;
  case 19:
    action.kind = CLOCK;
    v[0] = (int64_t)UINT32_MAX - chance.below(60000);
    v[1] = (int64_t)UINT32_MAX - chance.below(60);
    // A board does not leave out milliseconds within a search or a silence.
    if (state != DISARMED || world.hung) action.kind = WAIT;
    break;
  case 20:
    action.kind = SLIP;
    v[0] = chance.of({-500, -32, 32, 200});
    break;
  default:
    action.wait_ms = chance.of({9, 10, 11, 49, 51, 60, 150, 500, 1010});
  }
  return action;
}

static Setting random_setting(Chance &chance) {
  const double starts[] = {-0.1, -0.2, 0.1, 0.3, -0.4, -1};
  Setting setting = {};
  setting.start_mm = starts[chance.below(6)];
  setting.touch_mm = chance.one_in(3) ? 2 : QUICK_TOUCH_MM;
  setting.inverted = chance.one_in(4);
  setting.normally_closed = chance.one_in(4);
  setting.fault_pin = chance.below(3);
  setting.film_falls = chance.one_in(3);
  return setting;
}

extern "C" __attribute__((visibility("default"))) int64_t search_at_random(
    uint64_t seed, int64_t board_ms, Finding *finding) {
  Chance chance = {seed * 0x9E3779B97F4A7C15ull | 1};
  for (int i = 0; i < 8; i++) chance.next();
  int64_t passed_ms = 0;
  finding->rule = NO_RULE;
  while (passed_ms < board_ms) {
    Setting setting = random_setting(chance);
    begin(setting);
    Action *script = finding->script;
    int count = 0, most = 4 + chance.below(LONGEST_SCRIPT - 4);
    while (count < most && !c->rule && c->ms < 6000) {
      script[count] = random_action(chance, setting);
      play(script[count++]);
    }
    if (!c->rule) end_script(LAST_SILENCE_MS);
    passed_ms += c->ms;
    if (found(finding, setting, script, count, passed_ms)) break;
  }
  return passed_ms;
}

// ---- All short sequences -----------------------------------------------------------------------

// Before the sequences: a board in each state.
static std::vector<std::vector<Action>> beginnings() {
  Action limit = command(LIMITS, 1, QUICK_LIMITS, 10), arm = {ARM, 1, {}};
  Action search = command(HOME, 1, QUICK_SEARCH, 4);
  Action alive = {STREAM, 12, {0, 20, 2}}, longer = {STREAM, 60, {0, 20, 2}};
  Action press = {STREAM, 40, {256 * 20000, 20, 2}};
  Action here = search;
  here.values[0] = 0;
  Action withdraw = {WITHDRAW, 3, {}}, disarm = {DISARM, 3, {}}, silence = {WAIT, 60, {}};
  Action fault = {WAIT, 1010, {}};
  std::vector<Action> homed = {limit, arm, search, longer};
  auto after = [](std::vector<Action> first, std::vector<Action> then) {
    first.insert(first.end(), then.begin(), then.end());
    return first;
  };
  return {
      {},
      {limit},
      {limit, arm},
      {limit, arm, search},
      {limit, arm, search, alive},
      {limit, arm, here},
      homed,
      after(homed, {press}),
      after(homed, {press, withdraw}),
      after(homed, {press, disarm}),
      after(homed, {press, silence}),
      {limit, arm, fault},
  };
}

static std::vector<Action> alphabet() {
  Action limit = command(LIMITS, 1, QUICK_LIMITS, 10), search = command(HOME, 1, QUICK_SEARCH, 4);
  Action other = limit, here = search, widest = search;
  other.values[1] = RANGE;
  other.values[9] = INVERTED;
  here.values[0] = 0;
  widest.values[1] = 1200;
  widest.values[2] = 300;
  std::vector<Action> actions = {
      limit,
      other,
      search,
      here,
      widest,
      {ARM, 1, {}},
      {DISARM, 1, {}},
      {CLEAR, 1, {}},
      {WITHDRAW, 1, {}},
      {GREET, 1, {}},
      {VELOCITY, 1, {0, 20}},
      {VELOCITY, 1, {INT32_MAX, 1000}},
      {VELOCITY, 1, {INT32_MIN, 1000}},
      {VELOCITY, 1, {256 * 20000, 0}},
      {STREAM, 9, {256 * 32000, 20, 3}},
      {STREAM, 9, {-256 * 32000, 20, 3}},
      {RAW, 1, {HOME, 3}},
      {GARBAGE, 1, {7}},
      {FILM_IS, 3, {0}},
      {FILM_IS, 3, {8184}},
      {FILM_IS, 3, {3000}},
      {FILM_IS, 9, {0, 4}},
      {FILM_IS, 3, {-1}},
      {SWITCH_IS, 5, {0}},
      {SWITCH_IS, 5, {1}},
      {SWITCH_IS, 1, {-1}},
      {FAULT_IS, 3, {1}},
      {RESET_BY, 1, {RESET_PIN}},
      {RESET_BY, 1, {RESET_POWER_UP}},
      {RESET_BY, 5, {RESET_UNKNOWN, 3}},
      {HANG, 40, {}},
      {WAIT, 9, {}},
      {WAIT, 30, {}},
  };
  return actions;
}

struct Saved {
  std::vector<uint8_t> board;
  Checker checker;
};

static void save(Saved &saved) {
  saved.board.resize(host_state_bytes());
  host_save(saved.board.data());
  saved.checker = *c;
}

static void restore(const Saved &saved) {
  host_restore(saved.board.data());
  *c = saved.checker;
}

struct Enumeration {
  std::vector<Action> actions, script;
  Setting setting;
  int depth;
  int64_t passed_ms, sequences;
  Finding *finding;
  std::vector<Saved> saved;

  bool go_on(int left) {
    int64_t before_ms = c->ms;
    save(saved[left]);
    // Each beginning of a sequence is one, which ends in silence.
    end_script(LAST_SILENCE_MS);
    sequences++;
    passed_ms += c->ms - before_ms;
    if (found(finding, setting, script.data(), script.size(), passed_ms)) return true;
    for (size_t i = 0; left && i < actions.size(); i++) {
      restore(saved[left]);
      script.push_back(actions[i]);
      play(actions[i]);
      passed_ms += c->ms - before_ms;
      if (found(finding, setting, script.data(), script.size(), passed_ms)) return true;
      if (go_on(left - 1)) return true;
      script.pop_back();
    }
    return false;
  }
};

// Play all sequences up to a depth, of the share of them that a part of several has; the number of
// sequences is that of the finding's actions where nothing is found.
extern "C" __attribute__((visibility("default"))) int64_t search_all(
    int32_t depth, int32_t part, int32_t parts, int32_t reversed, int64_t *sequences,
    Finding *finding) {
  Enumeration all = {};
  all.actions = alphabet();
  all.depth = depth;
  all.finding = finding;
  all.saved.resize(depth + 1);
  all.setting = {0.1, QUICK_TOUCH_MM, reversed, 0, 0, 0};
  finding->rule = NO_RULE;
  std::vector<std::vector<Action>> first = beginnings();
  for (size_t i = part; i < first.size(); i += parts) {
    begin(all.setting);
    all.script = first[i];
    for (const Action &action : first[i]) play(action);
    all.passed_ms += c->ms;
    if (found(finding, all.setting, all.script.data(), all.script.size(), all.passed_ms)) break;
    if (all.go_on(depth)) break;
  }
  *sequences = all.sequences;
  return all.passed_ms;
}
