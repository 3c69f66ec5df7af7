/* An ATmega328P of simavr in real time, with its UART on a pseudo-terminal.
 *
 * board FIRMWARE.elf PPM: runs the chip PPM parts per million faster than this machine's clock, as
 * a resonator does. Prints the pseudo-terminal's path. Input A0 has 2.5 V and a sine wave of 1 V
 * at 1 Hz by the chip's own time.
 */
#define _GNU_SOURCE
#include <math.h>
#include <pty.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>

static const uint32_t FREQUENCY = 16000000;
static int terminal;

static void on_byte(struct avr_irq_t *irq, uint32_t value, void *param) {
  uint8_t byte = (uint8_t)value;
  if (write(terminal, &byte, 1) != 1) exit(1);
}

static void on_conversion(struct avr_irq_t *irq, uint32_t value, void *param) {
  avr_t *avr = param;
  double at_s = (double)avr->cycle / FREQUENCY;
  uint32_t millivolts = (uint32_t)lround(2500 + 1000 * sin(2 * M_PI * at_s));
  avr_raise_irq(avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_ADC0), millivolts);
}

static double now_s(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec + 1e-9 * now.tv_nsec;
}

int main(int argc, char **argv) {
  elf_firmware_t firmware;
  memset(&firmware, 0, sizeof firmware);
  if (argc != 3 || elf_read_firmware(argv[1], &firmware)) return 2;
  avr_t *avr = avr_make_mcu_by_name("atmega328p");
  int other;
  if (!avr || openpty(&terminal, &other, NULL, NULL, NULL)) return 2;
  struct termios raw;
  tcgetattr(other, &raw);
  cfmakeraw(&raw);
  tcsetattr(other, TCSANOW, &raw);
  avr_init(avr);
  firmware.frequency = FREQUENCY;
  avr_load_firmware(avr, &firmware);
  avr->frequency = FREQUENCY;
  avr->vcc = avr->avcc = avr->aref = 5000;
  uint32_t flags = 0;
  avr_ioctl(avr, AVR_IOCTL_UART_GET_FLAGS('0'), &flags);
  flags &= ~AVR_UART_FLAG_STDIO;
  avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
  avr_irq_register_notify(
      avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, NULL);
  avr_irq_register_notify(
      avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, ADC_IRQ_OUT_TRIGGER), on_conversion, avr);
  printf("%s\n", ttyname(other));
  fflush(stdout);
  double rate = FREQUENCY * (1 + 1e-6 * atof(argv[2])), began_s = now_s();
  for (;;) {
    avr_cycle_count_t until = (avr_cycle_count_t)((now_s() - began_s) * rate);
    while (avr->cycle < until) {
      int state = avr_run(avr);
      if (state == cpu_Done || state == cpu_Crashed) return 1;
    }
    usleep(500);
  }
}
