// The wrist's board: amplifiers of PVDF films on analogue inputs, in telepulse's binary framing.
//
// Any Arduino; no library. 1000 samples a second of one to three films and, optionally, an ECG:
// name the inputs in PINS, the ECG last. Scene class_wrist reads one film (a 10-bit converter; yours
// may have more); its source is
//
//   [sensing.source]
//   kind = "serial"
//   port = "/dev/ttyACM0"
//   framing = "binary"
//   rate = "1 kHz"
//   unit = "counts"
//   zero = 512
//   newtons_per_count = 2.9e-3
//   preload = "0.3 N"
//
// With more inputs it names them, the ECG as "announce":
//
//   names = ["cun", "guan", "announce"]
//   announce_unit = "counts"

#include "telepulse_frames.h"

const uint8_t PINS[] = {A0};
// With four inputs: 500000 here, and baud = 500000 in the scene.
const uint32_t BAUD = 115200;
const uint32_t PERIOD_US = 1000;
const uint8_t SAMPLES = 4;

const uint8_t CHANNELS = sizeof PINS;
const uint8_t FORMAT_INT16 = CHANNELS << 4 | 1;
// Format, counter and time before the samples; CRC, COBS's byte and the final zero after them.
const uint8_t FRAME_BYTES = 1 + 4 + 4 + 2 * CHANNELS * SAMPLES + 2 + 2;
static_assert(CHANNELS >= 1 && CHANNELS <= 4, "one to three films and an ECG");
static_assert(FRAME_BYTES <= LARGEST_FRAME, "too many SAMPLES");
static_assert(BAUD / 12 > FRAME_BYTES * (1000000 / PERIOD_US / SAMPLES), "BAUD is too low");

FrameWriter frame;
int16_t samples[SAMPLES][CHANNELS];
uint32_t counter = 0;
uint32_t next_us;
uint8_t filled = 0;

void setup() {
  Serial.begin(BAUD);
  next_us = micros();
}

void loop() {
  uint32_t now_us = micros();
  // The difference is right across the turn of micros() at 2^32.
  if ((int32_t)(now_us - next_us) < 0) {
    return;
  }
  uint32_t late_us = now_us - next_us;
  if (late_us >= PERIOD_US) {
    // A write has waited for the host. The samples of the periods that have passed were not taken,
    // and a frame holds consecutive ones: the host counts the gap in their numbers as missing.
    uint32_t missed = late_us / PERIOD_US;
    counter += filled + missed;
    filled = 0;
    next_us += missed * PERIOD_US;
  }
  next_us += PERIOD_US;
  for (uint8_t channel = 0; channel < CHANNELS; channel++) {
    samples[filled][channel] = analogRead(PINS[channel]);
  }
  if (++filled < SAMPLES) {
    return;
  }
  frame.add(FORMAT_INT16);
  frame.add(counter);
  frame.add(now_us);
  frame.add(samples);
  uint8_t encoded[LARGEST_FRAME];
  Serial.write(encoded, frame.encode(encoded));
  counter += SAMPLES;
  filled = 0;
}
