/* See chip.h. */
#define _GNU_SOURCE
#include "chip.h"
#include "../mechanics.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <pty.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <simavr/sim_elf.h>

/* Ten bits at 500 kbaud, and 0.1 ms. */
static const avr_cycle_count_t BYTE_CYCLES = 320, PIECE_CYCLES = 1600;
static int line, other = -1;
static avr_irq_t *uart_input, *analogue_input;

/* Frames end with a zero byte. Bytes that are written one by one fill a socket's memory soon. */
static void on_byte(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq, (void)param;
  static uint8_t bytes[64];
  static size_t count;
  bytes[count++] = (uint8_t)value;
  if (value && count < sizeof bytes) return;
  /* A UART does not wait for a reader: without one, bytes are lost. */
  if (line >= 0 && write(line, bytes, count) < 0 && errno != EAGAIN) line = -1;
  count = 0;
}

/* The simulator's errors name a lost byte of the line as a character, whatever it is. */
static void log_error(avr_t *avr, const int level, const char *format, va_list arguments) {
  (void)avr;
  char text[256];
  if (level > LOG_ERROR) return;
  vsnprintf(text, sizeof text, format, arguments);
  for (char *letter = text; *letter; letter++)
    if (*letter != '\n' && !isprint((unsigned char)*letter)) *letter = '?';
  fputs(text, stderr);
}

static void open_terminal(void) {
  if (openpty(&line, &other, NULL, NULL, NULL)) exit(2);
  struct termios raw;
  tcgetattr(other, &raw);
  cfmakeraw(&raw);
  tcsetattr(other, TCSANOW, &raw);
  printf("%s\n", ttyname(other));
  fflush(stdout);
}

avr_t *chip_make(const char *firmware_path, int socket) {
  elf_firmware_t firmware;
  memset(&firmware, 0, sizeof firmware);
  avr_global_logger_set(log_error);
  avr_t *chip = avr_make_mcu_by_name("atmega328p");
  if (!chip || elf_read_firmware(firmware_path, &firmware)) exit(2);
  if (socket < 0) open_terminal();
  else line = socket;
  fcntl(line, F_SETFL, O_NONBLOCK);
  avr_init(chip);
  firmware.frequency = FREQUENCY;
  avr_load_firmware(chip, &firmware);
  chip->frequency = FREQUENCY;
  chip->vcc = chip->avcc = chip->aref = 5000;
  chip->run_cycle_limit = 64;
  uint32_t flags = 0;
  avr_ioctl(chip, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
  flags &= ~(AVR_UART_FLAG_STDIO | AVR_UART_FLAG_POLL_SLEEP);
  avr_ioctl(chip, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  avr_irq_register_notify(
      avr_io_getirq(chip, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, NULL);
  uart_input = avr_io_getirq(chip, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
  analogue_input = avr_io_getirq(chip, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0);
  return chip;
}

/* Bytes of the host come in pieces, as from a USB bridge, and reach the chip one by one. */
static void receive(avr_t *chip) {
  static uint8_t bytes[64];
  static ssize_t count, given;
  static avr_cycle_count_t next_byte, next_piece;
  if (given < count) {
    if (chip->cycle < next_byte) return;
    next_byte = chip->cycle + BYTE_CYCLES;
    avr_raise_irq(uart_input, bytes[given++]);
  } else if (chip->cycle >= next_piece && line >= 0) {
    next_piece = chip->cycle + PIECE_CYCLES;
    count = read(line, bytes, sizeof bytes);
    given = 0;
  }
}

void chip_run(avr_t *chip, avr_cycle_count_t until) {
  while (chip->cycle < until) {
    int state = avr_run(chip);
    if (state == cpu_Done || state == cpu_Crashed) exit(1);
    receive(chip);
  }
}

void chip_unplug(void) {
  close(line);
  close(other);
  line = -1;
}

void chip_on_conversion(avr_t *chip, avr_irq_notify_t notify) {
  avr_irq_register_notify(
      avr_io_getirq(chip, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_OUT_TRIGGER), notify, chip);
}

/* simavr divides the range into 1023 parts, the chip into 1024: give what reads as the chip does. */
void chip_set_volts(double volts) {
  avr_raise_irq(analogue_input, (uint32_t)ceil(mechanics_reading(volts) * 5000.0 / 1023));
}

double now_s(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}
