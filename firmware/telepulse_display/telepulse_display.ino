// The finger's board: a stepper's carrier, a home switch and a film, for telepulse's drive kind
// "stepdir". PROTOCOL.md, one folder up, states the bytes, the states and what the board does by
// itself.
//
// Uno or Nano with a CNC shield (axis X), and 32-bit boards: see board.h. No library is needed.

#ifdef __AVR__
// Arduino's -Os takes a quarter longer: too long for a velocity each millisecond at the highest rate.
#pragma GCC optimize("O2")
#endif

#include "board.h"
#include "film_trend.h"
#include "frame_reader.h"
#include "stepper.h"
#include "watchdog.h"

const uint32_t BAUD = 500000;
const uint8_t PROTOCOL = 1;
const uint16_t FIRMWARE = 1 * 256 + 1;
const uint8_t DEBOUNCE_MS = 3;
// An armed board without a command switches its motor off.
const uint16_t ARMED_MS = 1000;
const uint8_t STATE_BYTES = 28 + 2;

// Numbers of PROTOCOL.md.
enum Format : uint8_t { STATE = 1, GREETING, ANSWER };
enum Command : uint8_t { GREET = 8, VELOCITY, HOME, LIMITS, ARM, DISARM, CLEAR, WITHDRAW };
enum State : uint8_t { DISARMED, ARMED, HOMING, READY, RUNNING, WITHDRAWING, WITHDRAWN, FAULT };
enum Cause : uint8_t { NONE, SILENCE, FILM, FAULT_PIN, HOST, RESET, HOME_SWITCH, NO_HOME,
                       STUCK_SWITCH, HOMING_TIMEOUT, PRESSED };
enum Result : uint8_t { DONE, WRONG_STATE, OUT_OF_BOUNDS, UNKNOWN, NO_LIMITS, FILM_OUTSIDE };
enum Option : uint8_t { INVERTED = 1, NORMALLY_CLOSED = 2, HAS_FAULT_PIN = 4, FAULT_IS_HIGH = 8,
                        FILM_FALLS = 16 };

// Sums and differences of positions, and twice a travel, have 32 bits.
const int32_t FURTHEST = 1L << 28;

struct __attribute__((packed)) Limits {
  int32_t lowest, highest;
  uint32_t acceleration, highest_rate;
  uint16_t film_least, film_most;
  uint32_t withdrawal, withdrawal_rate;
  uint16_t watchdog_ms;
  uint8_t options;
};
struct __attribute__((packed)) Search {
  uint32_t rate, distance, opening;
  uint16_t timeout_ms;
};

// From home on until withdrawn: the limits, and the position at a count of steps, with a check of
// both. They show where the tip leaves the finger after a reset.
struct {
  Limits limits;
  uint16_t crc;
  int32_t position;
  uint16_t steps;
  int32_t check;
} kept KEPT_OVER_RESET;

FrameReader reader;
FrameWriter writer;
Stepper stepper;
Watchdog watchdog;
Limits limits;
Search search;
bool has_limits = false;
State state = DISARMED;
Cause cause = NONE;
bool homed = false, seeking;
bool home_closed = false, faulty = false, film_outside = false;
uint8_t home_changing = 0;
// Of a search's part: the film, and where it began. The millisecond of the last change to armed or
// homing.
FilmTrend trend;
int32_t began_at;
uint32_t began_ms;
// Of a withdrawal: it takes the tip off the finger, not back to where a search began; the host has
// disarmed the board.
bool leaving, disarming;
uint32_t present_ms = 0;
uint16_t film = 0, sequence = 0;

bool is_on() { return state != DISARMED && state != FAULT; }

// ---- Motions -----------------------------------------------------------------------------------

uint16_t crc_of_kept() { return crc16((const uint8_t *)&kept.limits, sizeof kept.limits); }

void keep_limits() {
  kept.limits = limits;
  kept.crc = crc_of_kept();
}

void forget_limits() { kept.crc = ~crc_of_kept(); }

int32_t check_of_position() { return ~kept.position ^ kept.steps; }

void keep_position() {
  kept.position = stepper.position;
  kept.steps = stepper.counted_steps;
  kept.check = check_of_position();
}

// Switch the motor off. Its position is then unknown.
void switch_off(State next, Cause why) {
  pin_enable(false);
  stepper.halt();
  forget_limits();
  homed = false;
  state = next;
  cause = why;
}

void switch_on(int32_t position) {
  inward_level = !(limits.options & INVERTED);
  stepper.acceleration = limits.acceleration;
  stepper.halt();
  stepper.read_position();
  stepper.position = position;
  pin_enable(true);
  state = ARMED;
  began_ms = present_ms;
}

// Go to a position at the withdrawal's rate, and rest there.
void retreat(int32_t target, Cause why) {
  int32_t here = stepper.position;
  bool inward = target > here;
  // Without a ramp, which would press further.
  if (inward ? stepper.velocity < 0 : stepper.velocity > 0) stepper.halt();
  stepper.bound(min(target, here), max(target, here));
  float rate = limits.withdrawal_rate;
  stepper.wanted = inward ? rate : -rate;
  cause = why;
  state = WITHDRAWING;
  disarming = false;
}

// Take the tip off the finger.
void leave(int32_t target, Cause why) {
  leaving = true;
  retreat(min(target, stepper.position), why);
  keep_limits();
}

// End a search for home. Only the film shows whether its motion presses or leaves the finger; where
// it does not, the board stays where it is. The second part, which is towards the finger, is undone.
void end_search(Cause why) {
  if (seeking && trend.fell()) {
    leave(stepper.position - (int32_t)limits.withdrawal, why);
  } else if (!seeking || trend.rose()) {
    leaving = false;
    retreat(began_at, why);
  } else {
    switch_off(FAULT, why);
  }
}

// Steps may be lost, or home be where the tip presses: so both, the distance and home.
void withdraw(Cause why) {
  if (state == HOMING) end_search(why);
  else leave(min(stepper.position - (int32_t)limits.withdrawal, 0L), why);
}

// A home switch that is closed above home, or above the place of `arm`, may be stuck.
void withdraw_on() {
  bool inward = stepper.wanted > 0;
  bool at_home = leaving && home_closed && stepper.position <= 0;
  bool arrived = inward ? stepper.position >= stepper.highest
                        : stepper.position <= stepper.lowest;
  if (arrived || at_home) stepper.wanted = 0;
  if (stepper.wanted || stepper.velocity) return;
  if (disarming) {
    switch_off(DISARMED, NONE);
  } else if (leaving) {
    forget_limits();
    state = WITHDRAWN;
  } else {
    switch_off(FAULT, cause);
  }
}

void be_home() {
  homed = true;
  keep_limits();
  stepper.wanted = 0;
  stepper.bound(limits.lowest, limits.highest);
  state = READY;
}

void begin_part(int32_t least, int32_t most, float rate) {
  began_at = stepper.position;
  trend.begin(film);
  stepper.bound(least, most);
  stepper.wanted = rate;
}

// Seek the switch, away from the finger, then the place where it opens again.
void seek_home() {
  int32_t here = stepper.position;
  if (present_ms - began_ms > search.timeout_ms) {
    end_search(HOMING_TIMEOUT);
  } else if (seeking) {
    if (home_closed) {
      stepper.wanted = 0;
      if (stepper.velocity) return;
      seeking = false;
      begin_part(here, here + (int32_t)search.opening, max(search.rate / 8, 10UL));
    } else if (here <= stepper.lowest) {
      end_search(NO_HOME);
    }
  } else if (!home_closed) {
    stepper.position = 0;
    be_home();
  } else if (here >= stepper.highest) {
    end_search(STUCK_SWITCH);
  }
}

// ---- The board's own supervision ---------------------------------------------------------------

bool switch_is_closed() { return pin_home() == !!(limits.options & NORMALLY_CLOSED); }

void take_switch() {
  home_closed = switch_is_closed();
  home_changing = 0;
}

void read_inputs() {
  // By halves, a jump at any time is found within 1.5 ms.
  uint16_t halves[2];
  board_film(halves);
  film = halves[0] + halves[1];
  uint16_t least = 2 * min(halves[0], halves[1]), most = 2 * max(halves[0], halves[1]);
  film_outside = has_limits && (least < limits.film_least || most >= limits.film_most);
  faulty = (limits.options & HAS_FAULT_PIN) && pin_fault() == !!(limits.options & FAULT_IS_HIGH);
  home_changing = switch_is_closed() == home_closed ? 0 : home_changing + 1;
  if (home_changing == DEBOUNCE_MS) take_switch();
}

void supervise() {
  if (state == ARMED && present_ms - began_ms > ARMED_MS) switch_off(FAULT, SILENCE);
  if (state < HOMING || state > RUNNING) return;
  if (film_outside || (state == HOMING && trend.jumps(film))) {
    withdraw(FILM);
  } else if (faulty) {
    withdraw(FAULT_PIN);
  } else if (watchdog.timed_out(present_ms, limits.watchdog_ms)) {
    withdraw(SILENCE);
  } else if (state == HOMING) {
    if (trend.presses()) withdraw(PRESSED);
  } else if (state == RUNNING) {
    if (home_closed && stepper.position > (int32_t)search.opening) withdraw(HOME_SWITCH);
    else if (watchdog.expires(present_ms)) stepper.wanted = 0;
  }
}

void send() {
  uint8_t encoded[LARGEST_FRAME];
  board_write(encoded, writer.encode(encoded));
}

// ---- Commands ----------------------------------------------------------------------------------

// Return the number of the first field that is out of bounds; 0 if none is.
uint8_t wrong_limit(const Limits &l) {
  if (l.lowest < -FURTHEST || l.lowest > 0) return 1;
  if (l.highest < 1 || l.highest > FURTHEST) return 2;
  if (l.acceleration < 1000 || l.acceleration > 100000000) return 3;
  if (l.highest_rate < 10 || l.highest_rate > TICK_HZ) return 4;
  if (l.film_least >= l.film_most) return 5;
  if (l.film_most > FILM_FULL_SCALE + 1) return 6;
  if (l.withdrawal < 1 || l.withdrawal > (uint32_t)FURTHEST) return 7;
  // A second to its rate, and two at it, are the longest withdrawal.
  uint32_t least_rate = max(l.withdrawal / 2, 10UL), most_rate = min(l.highest_rate, l.acceleration);
  if (l.withdrawal_rate < least_rate || l.withdrawal_rate > most_rate) return 8;
  if (l.watchdog_ms < 10 || l.watchdog_ms > 500) return 9;
  return l.options > 31 ? 10 : 0;
}

uint8_t wrong_search(const Search &s) {
  if (s.rate && (s.rate < 10 || s.rate > limits.highest_rate)) return 1;
  // Where steps count the wrong way, or the switch is stuck, a search presses.
  if (s.distance > 2 * (uint32_t)(limits.highest - limits.lowest)) return 2;
  if (s.opening < 1 || s.opening > (uint32_t)limits.highest / 2) return 3;
  return s.timeout_ms < 1 || s.timeout_ms > 60000 ? 4 : 0;
}

Result begin_home(const Search &wanted, uint8_t &field) {
  if (state != ARMED) return WRONG_STATE;
  if ((field = wrong_search(wanted))) return OUT_OF_BOUNDS;
  if (film_outside) return FILM_OUTSIDE;
  search = wanted;
  began_ms = present_ms;
  watchdog.restart(present_ms, limits.watchdog_ms);
  if (!search.rate) {
    stepper.position = 0;
    be_home();
    return DONE;
  }
  state = HOMING;
  seeking = true;
  begin_part(stepper.position - (int32_t)search.distance, FURTHEST, -(float)search.rate);
  return DONE;
}

Result take_limits(const Limits &wanted, uint8_t &field) {
  if (state != DISARMED) return WRONG_STATE;
  if ((field = wrong_limit(wanted))) return OUT_OF_BOUNDS;
  limits = wanted;
  has_limits = true;
  // By the new options.
  take_switch();
  trend.scale(limits.film_least, limits.film_most, limits.options & FILM_FALLS);
  return DONE;
}

Result arm() {
  if (!has_limits) return NO_LIMITS;
  if (state != DISARMED) return WRONG_STATE;
  switch_on(0);
  return DONE;
}

// A board that may press, or is about to, takes the tip back to home before.
void disarm() {
  if (state == HOMING) end_search(HOST);
  else if (state == READY || state == RUNNING) leave(0, HOST);
  if (state == WITHDRAWING) disarming = true;
  else switch_off(DISARMED, NONE);
}

Result take_command(uint8_t format, uint8_t at, uint8_t field_bytes, uint8_t &field) {
  if (format == HOME && field_bytes == sizeof(Search)) {
    return begin_home(reader.read<Search>(at), field);
  }
  if (format == LIMITS && field_bytes == sizeof(Limits)) {
    return take_limits(reader.read<Limits>(at), field);
  }
  if (field_bytes) return UNKNOWN;
  switch (format) {
  case ARM:
    return arm();
  case DISARM:
    disarm();
    return DONE;
  case CLEAR:
    if (state != WITHDRAWN && state != FAULT) return WRONG_STATE;
    switch_off(DISARMED, NONE);
    return DONE;
  case WITHDRAW:
    if (state < HOMING || state > RUNNING) return WRONG_STATE;
    withdraw(HOST);
    return DONE;
  }
  return UNKNOWN;
}

void take_velocity(uint16_t number, uint8_t at) {
  int32_t velocity = reader.read<int32_t>(at);
  uint16_t valid_ms = reader.read<uint16_t>(at);
  if (state < HOMING || state > RUNNING || valid_ms < 1 || valid_ms > 1000) return;
  sequence = number;
  watchdog.restart(present_ms, valid_ms);
  // While homing a sign of life alone.
  if (state == HOMING) return;
  float most = limits.highest_rate;
  stepper.wanted = constrain(velocity / 256.0f, -most, most);
  state = RUNNING;
}

void greet(uint16_t number) {
  writer.add(GREETING);
  writer.add(number);
  writer.add(PROTOCOL);
  writer.add(FIRMWARE);
  writer.add(TICK_HZ);
  writer.add(FILM_FULL_SCALE);
  writer.add(board_reset_cause());
  for (const char *letter = CHIP_NAME; *letter; letter++) writer.add(*letter);
  send();
}

void take_frame() {
  if (reader.length < 3) return;
  uint8_t at = 0, format = reader.read<uint8_t>(at);
  uint16_t number = reader.read<uint16_t>(at);
  uint8_t field_bytes = reader.length - at, field = 0;
  if (format == VELOCITY && field_bytes == 6) return take_velocity(number, at);
  if (format == GREET && !field_bytes) {
    sequence = number;
    return greet(number);
  }
  Result result = take_command(format, at, field_bytes, field);
  if (result == DONE) sequence = number;
  writer.add(ANSWER);
  writer.add(number);
  writer.add(format);
  writer.add(result);
  writer.add(field);
  send();
}

// ---- Each millisecond --------------------------------------------------------------------------

void send_state(uint32_t now_us) {
  // A frame that waited for the line would delay the motion.
  if (board_writable() < STATE_BYTES) return;
  bool low = homed && stepper.position <= limits.lowest;
  bool high = homed && stepper.position >= limits.highest;
  bool bits[] = {homed,        home_closed, low,     high,   faulty,
                 film_outside, has_limits,  is_on(), watchdog.expired};
  uint16_t flags = 0;
  for (uint8_t bit = 0; bit < sizeof bits; bit++) flags |= (uint16_t)bits[bit] << bit;
  writer.add(STATE);
  writer.add(present_ms);
  writer.add(now_us);
  writer.add(film);
  writer.add(stepper.position);
  writer.add((int32_t)(stepper.velocity * 256));
  writer.add(state);
  writer.add(cause);
  writer.add(flags);
  writer.add(sequence);
  writer.add(reader.rejected);
  send();
}

void setup() {
  board_begin(BAUD);
  stepper.counted_steps = tick_steps;
  bool was_on = kept.crc == crc_of_kept();
  if (was_on && board_reset_cause() != RESET_POWER_UP && !wrong_limit(kept.limits)) {
    limits = kept.limits;
    // The interrupt goes on where the program hangs. A reset in the midst of keep_position() leaves
    // no position.
    int32_t position = kept.position + (int16_t)(tick_steps - kept.steps);
    switch_on(kept.check == check_of_position() ? position : limits.highest);
    withdraw(RESET);
    return;
  }
  forget_limits();
}

void loop() {
  // One frame at a time, so that no flood of them delays the motion.
  for (int16_t byte; (byte = board_read()) >= 0;) {
    if (reader.take(byte)) {
      take_frame();
      break;
    }
  }
  uint8_t passed_ms = stepper.passed_ms();
  if (!passed_ms) return;
  uint32_t now_us = micros();
  stepper.read_position();
  present_ms += passed_ms;
  board_alive();
  read_inputs();
  supervise();
  if (state == HOMING) trend.add(film);
  if (state == HOMING) seek_home();
  if (state == WITHDRAWING) withdraw_on();
  if (is_on()) {
    keep_position();
    stepper.follow(passed_ms * 1e-3f);
  }
  send_state(now_us);
}
