/* The wrist's board in real time: an ATmega328P that samples a sine wave.
 *
 * sensor FIRMWARE.elf PPM: runs the chip PPM parts per million faster than this machine's clock, as
 * a resonator does. Prints the pseudo-terminal's path. Input A0 has 2.5 V and a sine wave of 1 V
 * at 1 Hz by the chip's own time.
 */
#include "chip.h"

#include <math.h>
#include <stdlib.h>
#include <unistd.h>

static void on_conversion(struct avr_irq_t *irq, uint32_t value, void *param) {
  (void)irq, (void)value;
  avr_t *chip = param;
  chip_set_volts(2.5 + sin(2 * M_PI * chip->cycle / FREQUENCY));
}

int main(int argc, char **argv) {
  if (argc != 3) return 2;
  avr_t *chip = chip_make(argv[1], -1);
  chip_on_conversion(chip, on_conversion);
  double rate = FREQUENCY * (1 + 1e-6 * atof(argv[2])), began_s = now_s();
  for (;;) {
    chip_run(chip, (avr_cycle_count_t)((now_s() - began_s) * rate));
    usleep(500);
  }
}
