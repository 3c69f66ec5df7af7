/* The finger's board at a finger: an ATmega328P that drives a stepper, screw, rubber and fingertip.
 *
 * display FIRMWARE.elf [NAME=VALUE ...]: prints the pseudo-terminal's path, then obeys the lines of
 * its input. It runs in real time; with clock=0 only for the time that it is told, and then with
 * its line on the socket of socket=NUMBER, as a terminal delivers bytes in its own time. The other
 * settings are those of mechanics.h.
 *
 * trace=PATH writes rows: "ms", time in s, tip in um, force in mN, motor on; and "step", cycle of
 * its edge, direction.
 *
 * Input, a command a line:
 *   run MS          with clock=0, run for a time; prints "ran"
 *   film VOLTS      the film's amplifier has this output, whatever the force; "film ok" ends it
 *   switch 0 | 1    the home switch is stuck open or closed; "switch ok" ends it
 *   fault 0 | 1     level of the carrier's fault pin
 *   reset [MS]      reset pin, as DTR pulls it; a bootloader then waits for a time
 *   hang ADDRESS    the program goes on at this address, such as that of an endless loop
 *   unplug          the cable is gone
 *   report          prints a line of JSON; late_ms: the longest that this machine kept the chip
 *                   waiting since the last report
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "../mechanics.h"
#include "chip.h"

/* Of the ATmega328P: timer 1's interrupt, and the registers of ports B and D and of the reset. */
enum { TIMER1_COMPA = 11, PINB = 0x23, DDRB = 0x24, PORTB = 0x25, PORTD = 0x2B, MCUSR = 0x54 };
enum { EXTRF = 2, STEP_BIT = 2, DIRECTION_BIT = 5, HOME_BIT = 1, FAULT_BIT = 2 };

/* Speed against this machine's clock, or 0; open socket of the line, or -1 for a terminal. */
static double clock_speed = 1, socket_number = -1;
static const double TICK_S = 500.0 / FREQUENCY;

static avr_t *chip;
static FILE *trace;
static struct mechanics mechanics;
static int fault_level = 1;
static double latest_s;
static const double LOST_S = 25e-3;
static avr_cycle_count_t held_until, entered, in_tick, longest_tick, ticks;

static void change_setting(const char *argument) {
  char name[32];
  double value, *setting;
  if (!strncmp(argument, "trace=", 6)) {
    if (!(trace = fopen(argument + 6, "w"))) exit(2);
    return;
  }
  if (sscanf(argument, "%31[^=]=%lf", name, &value) != 2) exit(2);
  if (!strcmp(name, "clock")) setting = &clock_speed;
  else if (!strcmp(name, "socket")) setting = &socket_number;
  else setting = mechanics_setting(&mechanics, name);
  if (!setting) exit(2);
  *setting = value;
}

/* ---- Pins ------------------------------------------------------------------------------------ */

static bool motor_is_on(void) {
  bool driven = chip->data[DDRB] & 1;
  return driven && !(chip->data[PORTB] & 1) && chip->cycle >= held_until;
}

/* In the register itself, as simavr's line to it keeps its level over a reset and the pin does not. */
static void set_input(int bit, bool level) {
  chip->data[PINB] = (uint8_t)((chip->data[PINB] & ~(1 << bit)) | level << bit);
}

static void move_for_a_tick(void) {
  mechanics_move(&mechanics, motor_is_on(), TICK_S);
  set_input(HOME_BIT, !mechanics_switch_closed(&mechanics));
  set_input(FAULT_BIT, fault_level);
}

static void on_step(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq, (void)param;
  if (!value) return;
  int direction = chip->data[PORTD] >> DIRECTION_BIT & 1 ? 1 : -1;
  if (motor_is_on()) mechanics_step(&mechanics, direction);
  if (trace) fprintf(trace, "step,%llu,%d\n", (unsigned long long)chip->cycle, direction);
}

static void on_conversion(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq, (void)value, (void)param;
  chip_set_volts(mechanics_film_v(&mechanics));
}

static void on_interrupt(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq, (void)param;
  if (value) {
    entered = chip->cycle;
  } else if (entered) {
    avr_cycle_count_t took = chip->cycle - entered;
    in_tick += took;
    ticks++;
    if (took > longest_tick) longest_tick = took;
    entered = 0;
  }
}

/* ---- Running --------------------------------------------------------------------------------- */

static void run(avr_cycle_count_t until) {
  static avr_cycle_count_t next_tick, next_row;
  while (chip->cycle < until) {
    if (chip->cycle < held_until) chip->cycle += 500;
    else chip_run(chip, chip->cycle + 1);
    while (next_tick <= chip->cycle) next_tick += 500, move_for_a_tick();
    if (trace && next_row <= chip->cycle) {
      next_row += FREQUENCY / 1000;
      fprintf(trace, "ms,%.4f,%.3f,%.3f,%d\n", (double)chip->cycle / FREQUENCY,
              1e6 * mechanics.tip_m, 1e3 * mechanics.force_n, motor_is_on());
    }
  }
}

static void reset(double bootloader_ms) {
  avr_reset(chip);
  chip->data[MCUSR] = EXTRF;
  held_until = chip->cycle + (avr_cycle_count_t)(bootloader_ms * FREQUENCY / 1000);
}

static void report(void) {
  printf("{\"time_s\": %.6f, \"tip_um\": %.3f, \"force_mn\": %.3f, \"motor_on\": %d, "
         "\"lost_steps\": %ld, \"tick_share\": %.4f, \"tick_cycles\": %llu, \"late_ms\": %.1f}\n",
         (double)chip->cycle / FREQUENCY, 1e6 * mechanics.tip_m, 1e3 * mechanics.force_n,
         motor_is_on(), (long)mechanics.lost_steps, ticks ? in_tick / (ticks * 500.0) : 0, (unsigned long long)longest_tick,
         1e3 * latest_s);
  fflush(stdout);
  latest_s = 0;
}

static void obey(const char *line) {
  double number = NAN;
  char word[16] = "";
  if (sscanf(line, "%15s %lf", word, &number) < 1) return;
  if (!strcmp(word, "run")) {
    run(chip->cycle + (avr_cycle_count_t)(number * FREQUENCY / 1000));
    if (trace) fflush(trace);
    printf("ran\n");
    fflush(stdout);
  } else if (!strcmp(word, "film")) {
    mechanics.film_v = number;
  } else if (!strcmp(word, "switch")) {
    mechanics.stuck_switch = isnan(number) ? -1 : number;
  } else if (!strcmp(word, "fault")) {
    fault_level = (int)number;
  } else if (!strcmp(word, "reset")) {
    reset(isnan(number) ? 0 : number);
  } else if (!strcmp(word, "hang")) {
    chip->pc = (avr_flashaddr_t)number;
  } else if (!strcmp(word, "unplug")) {
    chip_unplug();
  } else if (!strcmp(word, "report")) {
    report();
  } else {
    exit(2);
  }
}

/* Obey the lines that have come. Exits at the input's end. */
static void read_input(void) {
  static char line[128];
  static size_t length;
  for (;;) {
    ssize_t count = read(STDIN_FILENO, line + length, 1);
    if (count < 0 && errno == EAGAIN) return;
    if (count <= 0) exit(0);
    if (line[length] != '\n' && length < sizeof line - 2) {
      length++;
      continue;
    }
    line[length] = '\0';
    length = 0;
    obey(line);
  }
}

int main(int argc, char **argv) {
  if (argc < 2) return 2;
  mechanics = USUAL_MECHANICS;
  for (int i = 2; i < argc; i++) change_setting(argv[i]);
  mechanics_begin(&mechanics);
  chip = chip_make(argv[1], (int)socket_number);
  chip_on_conversion(chip, on_conversion);
  avr_irq_register_notify(
      avr_io_getirq(chip, AVR_IOCTL_IOPORT_GETIRQ('D'), STEP_BIT), on_step, NULL);
  avr_irq_register_notify(
      avr_get_interrupt_irq(chip, TIMER1_COMPA) + AVR_INT_IRQ_RUNNING, on_interrupt, NULL);
  double began_s = now_s();
  if (clock_speed) fcntl(STDIN_FILENO, F_SETFL, O_NONBLOCK);
  for (;;) {
    read_input();
    double now = now_s(), late_s = (now - began_s) * clock_speed;
    late_s -= (double)chip->cycle / FREQUENCY;
    latest_s = fmax(latest_s, late_s);
    /* A chip that was kept waiting for long loses the time: it must not run faster than it can. */
    if (late_s > LOST_S) {
      began_s += late_s / clock_speed;
      late_s = 0;
    }
    run(chip->cycle + (avr_cycle_count_t)(late_s * FREQUENCY));
    usleep(500);
  }
}
