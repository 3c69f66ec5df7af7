// See host.h.
#include "host.h"

#include "../mechanics.h"

// Of begin.cpp and end.cpp; and of the section of variables that a reset keeps.
extern char host_data_begin[], host_data_end[], host_zeros_begin[], host_zeros_end[];
#ifdef __APPLE__
extern char kept_begin[] __asm("section$start$__DATA$over_reset");
extern char kept_end[] __asm("section$end$__DATA$over_reset");
#else
extern char kept_begin[] __asm("__start_over_reset") __attribute__((visibility("hidden")));
extern char kept_end[] __asm("__stop_over_reset") __attribute__((visibility("hidden")));
#endif

namespace {

const uint8_t HALF_MS_TICKS = 16, HALF_MS_BYTES = 25;
const int64_t WATCHDOG_TICKS = 30 * 2 * HALF_MS_TICKS;
const uint8_t VOID = 0x55;
const double BUSY_TICKS = 8;

// Bytes on their way.
template <uint16_t ROOM> struct Queue {
  uint8_t bytes[ROOM];
  uint16_t begin, count;

  uint16_t room() const { return ROOM - count; }

  bool put(uint8_t byte) {
    if (count == ROOM) return false;
    bytes[(begin + count++) % ROOM] = byte;
    return true;
  }

  uint8_t take() {
    uint8_t byte = bytes[begin];
    begin = (begin + 1) % ROOM;
    count--;
    return byte;
  }
};

// What surrounds the sketch.
struct World {
  struct mechanics mechanics;
  double inverted, normally_closed, fault_pin, fault, carrier_off, hung, busy_ticks;
  int64_t ticks, passed_ms, steps_in, steps_out, steps_off, hangs, dropped;
  // Ticks: of the start, of the last board_alive(), and of the end of a bootloader's wait.
  int64_t started_at, alive_at, held_until;
  // The clock's micros() at the start.
  uint32_t started_us;
  int32_t given_film[2];
  uint16_t film_halves[2], film_sum, conversion;
  bool motor_on, step_pin, direction_pin;
  uint8_t reset_cause;
  // In this pass of loop().
  uint8_t guarded;
  // In the board, as large as those of board_avr.h; and in the host.
  Queue<127> received, sent;
  Queue<512> fed;
  Queue<1024> taken;
} world;

bool motor_turns() { return world.motor_on && !world.carrier_off; }

uint16_t film_reading() { return mechanics_reading(mechanics_film_v(&world.mechanics)); }

void tick();

} // namespace

#include "../telepulse_display/telepulse_display.ino"

// ---- What the sketch needs of a board ----------------------------------------------------------

void pin_step(bool high) {
  bool rises = high && !world.step_pin;
  world.step_pin = high;
  if (!rises) return;
  bool inward = world.direction_pin != (world.inverted != 0);
  if (!motor_turns()) {
    world.steps_off++;
    return;
  }
  (inward ? world.steps_in : world.steps_out)++;
  mechanics_step(&world.mechanics, inward ? 1 : -1);
}

void pin_direction(bool high) { world.direction_pin = high; }

void pin_enable(bool on) { world.motor_on = on; }

bool pin_home() {
  return mechanics_switch_closed(&world.mechanics) == (world.normally_closed != 0);
}

bool pin_fault() {
  bool active = world.fault_pin != 0 && world.fault != 0;
  return active == (world.fault_pin == 2);
}

// As of the AVR's timer, which counts 4 us.
uint32_t micros() {
  int64_t passed_us = (world.ticks - world.started_at) * 125 / 4;
  return world.started_us + ((uint32_t)passed_us & ~3u);
}

// The AVR reads its position at once, and computes the rate, in floating point, meanwhile.
void noInterrupts() {
  if (!world.guarded++) return;
  for (double passed = 0; passed < world.busy_ticks; passed++) tick();
}

void interrupts() {}

void board_begin(uint32_t) { world.conversion = film_reading(); }

void board_film(uint16_t *halves) { memcpy(halves, world.film_halves, sizeof world.film_halves); }

void board_alive() { world.alive_at = world.ticks; }

uint8_t board_reset_cause() { return world.reset_cause; }

int16_t board_read() { return world.received.count ? world.received.take() : -1; }

uint8_t board_writable() { return world.sent.room(); }

void board_write(const uint8_t *bytes, uint8_t count) {
  while (board_writable() < count) tick();
  while (count--) world.sent.put(*bytes++);
}

// ---- Time --------------------------------------------------------------------------------------

namespace {

void half_has_passed(bool second) {
  int32_t given = world.given_film[second];
  world.film_halves[second] = given < 0 ? world.film_sum : given;
  world.film_sum = 0;
  world.passed_ms += second;
  if (world.mechanics.rigid) mechanics_move(&world.mechanics, motor_turns(), 0);
  for (uint8_t i = 0; i < HALF_MS_BYTES && world.sent.count; i++) {
    world.dropped += !world.taken.put(world.sent.take());
  }
  for (uint8_t i = 0; i < HALF_MS_BYTES && world.fed.count; i++) {
    world.dropped += !world.received.put(world.fed.take());
  }
}

// As the interrupt of board_avr.h, with a conversion every other tick.
void tick() {
  world.ticks++;
  stepper_tick();
  if (!world.mechanics.rigid) mechanics_move(&world.mechanics, motor_turns(), 1.0 / TICK_HZ);
  if ((ticks_left & 1) && world.given_film[0] < 0) {
    world.film_sum += world.conversion;
    world.conversion = film_reading();
  }
  if (ticks_left % HALF_MS_TICKS == 0) half_has_passed(ticks_left == TICKS_PER_MS);
}

void pass_half() {
  do tick();
  while (ticks_left % HALF_MS_TICKS);
  if (!world.hung) {
    do {
      world.guarded = 0;
      loop();
    } while (world.received.count);
  }
  if (world.ticks - world.alive_at > WATCHDOG_TICKS) {
    world.hangs++;
    world.hung = 0;
    host_reset(RESET_WATCHDOG, 0);
  }
}

void start_sketch();

void wait_for_bootloader() {
  world.ticks += TICKS_PER_MS;
  world.passed_ms++;
  mechanics_move(&world.mechanics, false, 1e-3);
  if (world.ticks == world.held_until) start_sketch();
}

void start_sketch() {
  world.started_at = world.alive_at = world.ticks;
  world.guarded = 0;
  setup();
}

// ---- State -------------------------------------------------------------------------------------

// The variables as they were loaded, in memory of its own.
uint8_t *loaded;

size_t data_bytes() { return host_data_end - host_data_begin; }

size_t zeros_bytes() { return host_zeros_end - host_zeros_begin; }

size_t kept_bytes() { return kept_end - kept_begin; }

void save_variables(uint8_t *to) {
  memcpy(to, host_data_begin, data_bytes());
  memcpy(to + data_bytes(), host_zeros_begin, zeros_bytes());
}

void restore_variables(const uint8_t *from) {
  memcpy(host_data_begin, from, data_bytes());
  memcpy(host_zeros_begin, from + data_bytes(), zeros_bytes());
}

bool is_saved(const void *variable) {
  const char *at = (const char *)variable;
  return (at >= host_data_begin && at < host_data_end) ||
         (at >= host_zeros_begin && at < host_zeros_end);
}

double *setting(const char *name) {
  const struct {
    const char *name;
    double *value;
  } settings[] = {
      {"inverted", &world.inverted},   {"normally_closed", &world.normally_closed},
      {"fault_pin", &world.fault_pin}, {"fault", &world.fault},
      {"hung", &world.hung},           {"carrier_off", &world.carrier_off},
      {"busy_ticks", &world.busy_ticks},
  };
  for (const auto &each : settings)
    if (!strcmp(each.name, name)) return each.value;
  return mechanics_setting(&world.mechanics, name);
}

} // namespace

bool host_new(void) {
  if (!is_saved(&world) || !is_saved(&stepper) || !is_saved(&state)) return false;
  if (loaded) {
    restore_variables(loaded);
  } else {
    loaded = (uint8_t *)malloc(data_bytes() + zeros_bytes());
    save_variables(loaded);
  }
  world.mechanics = USUAL_MECHANICS;
  world.busy_ticks = BUSY_TICKS;
  world.given_film[0] = world.given_film[1] = -1;
  return true;
}

bool host_set(const char *name, double value) {
  double *found = setting(name);
  if (found) *found = value;
  return found;
}

void host_reset(uint8_t cause, uint32_t bootloader_ms) {
  World present = world;
  restore_variables(loaded);
  world = present;
  world.received.count = world.sent.count = 0;
  world.motor_on = world.step_pin = false;
  world.film_sum = world.film_halves[0] = world.film_halves[1] = 0;
  world.started_us = 0;
  world.reset_cause = cause;
  world.held_until = world.ticks + bootloader_ms * TICKS_PER_MS;
  if (!bootloader_ms) start_sketch();
}

void host_power_up(void) {
  memset(kept_begin, VOID, kept_bytes());
  mechanics_begin(&world.mechanics);
  host_reset(RESET_POWER_UP, 0);
}

void host_set_clock(uint32_t us, uint32_t ms) {
  world.started_us = 0;
  world.started_us = us - micros();
  present_ms = ms;
}

void host_run(uint32_t ms) {
  for (int64_t until = world.passed_ms + ms; world.passed_ms < until;) {
    if (world.ticks >= world.held_until) pass_half();
    else wait_for_bootloader();
  }
}

uint32_t host_feed(const uint8_t *bytes, uint32_t count) {
  uint32_t given = 0;
  while (given < count && world.fed.put(bytes[given])) given++;
  return given;
}

uint32_t host_take(uint8_t *bytes, uint32_t most) {
  uint32_t count = 0;
  while (count < most && world.taken.count) bytes[count++] = world.taken.take();
  return count;
}

void host_film(int32_t first, int32_t second) {
  world.given_film[0] = first;
  world.given_film[1] = second;
}

void host_look(struct host_view *view) {
  *view = (struct host_view){
      .tip_m = world.mechanics.tip_m,
      .force_n = world.mechanics.force_n,
      .lost_steps = world.mechanics.lost_steps,
      .ticks = world.ticks,
      .steps_in = world.steps_in,
      .steps_out = world.steps_out,
      .steps_off = world.steps_off,
      .hangs = world.hangs,
      .dropped = world.dropped,
      .velocity = stepper.velocity,
      .wanted = stepper.wanted,
      .position = stepper.position,
      .lowest = stepper.lowest,
      .highest = stepper.highest,
      .began_at = began_at,
      .present_ms = present_ms,
      .search_opening = search.opening,
      .limits_lowest = limits.lowest,
      .limits_highest = limits.highest,
      .limits_acceleration = limits.acceleration,
      .limits_highest_rate = limits.highest_rate,
      .limits_withdrawal = limits.withdrawal,
      .limits_withdrawal_rate = limits.withdrawal_rate,
      .limits_film_least = limits.film_least,
      .limits_film_most = limits.film_most,
      .limits_watchdog_ms = limits.watchdog_ms,
      .film = film,
      .sequence = sequence,
      .limits_options = limits.options,
      .state = state,
      .cause = cause,
      .rejected = reader.rejected,
      .homed = homed,
      .home_closed = home_closed,
      .faulty = faulty,
      .film_outside = film_outside,
      .has_limits = has_limits,
      .expired = watchdog.expired,
      .motor_on = world.motor_on,
      .step_pin = world.step_pin,
      .direction_pin = world.direction_pin,
      .home_pin = pin_home(),
      .fault_pin = pin_fault(),
  };
}

uint32_t host_state_bytes(void) { return data_bytes() + zeros_bytes() + kept_bytes(); }

void host_save(void *state_) {
  uint8_t *to = (uint8_t *)state_;
  save_variables(to);
  memcpy(to + data_bytes() + zeros_bytes(), kept_begin, kept_bytes());
}

void host_restore(const void *state_) {
  const uint8_t *from = (const uint8_t *)state_;
  restore_variables(from);
  memcpy(kept_begin, from + data_bytes() + zeros_bytes(), kept_bytes());
}
