/* An ATmega328P of simavr at 16 MHz, with its UART on a pseudo-terminal or a socket. */
#pragma once

#include <stdbool.h>
#include <stdint.h>

#include <simavr/avr_adc.h>
#include <simavr/avr_ioport.h>
#include <simavr/avr_uart.h>
#include <simavr/sim_avr.h>

#define FREQUENCY 16000000

/* Make a chip that runs a firmware, with its UART on an open socket; with -1 on a pseudo-terminal,
 * whose path it prints. Exits where it cannot. */
avr_t *chip_make(const char *firmware_path, int socket);

/* Run until a cycle. Bytes of the host reach the chip at 500 kbaud. Exits on a crash. */
void chip_run(avr_t *chip, avr_cycle_count_t until);

/* Close the line, as an unplugged cable does. The chip runs on, and nothing is connected. */
void chip_unplug(void);

/* Call `notify` at each conversion's start; it then sets input A0 by `chip_set_volts`. */
void chip_on_conversion(avr_t *chip, avr_irq_notify_t notify);
void chip_set_volts(double volts);

double now_s(void);
