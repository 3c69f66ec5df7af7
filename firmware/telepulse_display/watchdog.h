// Time since the host's last velocity. After that velocity's validity the motor stops; after the
// watchdog's time the board withdraws the tip. The processor's watchdog (board_avr.h) is another one:
// it resets a program that hangs.

#pragma once

#include <stdint.h>

struct Watchdog {
  bool expired = false;

  void restart(uint32_t now_ms, uint16_t valid_ms) {
    commanded_ms = now_ms;
    validity_ms = valid_ms;
    expired = false;
  }

  bool timed_out(uint32_t now_ms, uint16_t after_ms) const {
    return now_ms - commanded_ms > after_ms;
  }

  bool expires(uint32_t now_ms) {
    if (now_ms - commanded_ms > validity_ms) expired = true;
    return expired;
  }

private:
  uint32_t commanded_ms = 0;
  uint16_t validity_ms = 0;
};
