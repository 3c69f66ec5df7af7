// A PVDF film's amplifier on an analogue input, sent in telepulse's binary framing.
//
// Any Arduino; no library. 1000 samples a second in frames of 4 need 7 kB/s, so that 115200 baud
// do. The scene that reads it (a 10-bit converter; yours may have more):
//
//   [sensing.source]
//   kind = "serial"
//   port = "/dev/ttyACM0"
//   framing = "binary"
//   rate = "1 kHz"
//   unit = "counts"
//   zero = 512
//   newtons_per_count = 0.001

#include <Arduino.h>

const uint8_t PIN = A0;
const uint32_t PERIOD_US = 1000;
const uint8_t SAMPLES = 4;

// format, counter, time, samples, CRC: little-endian, as all Arduinos are.
const uint8_t FORMAT_INT16 = 0x11;
const uint8_t HEAD = 1 + 4 + 4;
const uint8_t BODY = HEAD + 2 * SAMPLES + 2;

uint8_t body[BODY];
uint32_t counter = 0;
uint32_t next_us;
uint8_t filled = 0;

// CRC-16/CCITT-FALSE.
uint16_t crc16(const uint8_t *data, uint8_t length) {
  uint16_t crc = 0xFFFF;
  for (uint8_t i = 0; i < length; i++) {
    crc ^= (uint16_t)data[i] << 8;
    for (uint8_t bit = 0; bit < 8; bit++) {
      crc = crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1;
    }
  }
  return crc;
}

// COBS: no zero byte but the one that ends a frame. Bodies here are shorter than 254 bytes.
void send(const uint8_t *data, uint8_t length) {
  uint8_t encoded[BODY + 2];
  uint8_t code_at = 0, end = 1;
  for (uint8_t i = 0; i < length; i++) {
    if (data[i]) {
      encoded[end++] = data[i];
    } else {
      encoded[code_at] = end - code_at;
      code_at = end++;
    }
  }
  encoded[code_at] = end - code_at;
  encoded[end++] = 0;
  Serial.write(encoded, end);
}

void setup() {
  Serial.begin(115200);
  next_us = micros();
}

void loop() {
  uint32_t now_us = micros();
  // The difference is right across the turn of micros() at 2^32.
  if ((int32_t)(now_us - next_us) < 0) {
    return;
  }
  next_us += PERIOD_US;
  int16_t sample = analogRead(PIN);
  memcpy(body + HEAD + 2 * filled, &sample, 2);
  filled++;
  if (filled < SAMPLES) {
    return;
  }
  body[0] = FORMAT_INT16;
  memcpy(body + 1, &counter, 4);
  memcpy(body + 5, &now_us, 4);
  uint16_t crc = crc16(body, BODY - 2);
  memcpy(body + BODY - 2, &crc, 2);
  send(body, BODY);
  counter += SAMPLES;
  filled = 0;
}
