// Frames of telepulse's boards: COBS, ended by a zero byte, with a CRC-16/CCITT-FALSE at the end.
//
// This file is the same in the folders of both sketches, so that each opens and compiles as it is.
// Multi-byte numbers are little-endian, as those of all boards that Arduino's core runs on.
#pragma once

#include <Arduino.h>
#ifdef __AVR__
#include <util/crc16.h>
#endif

// A body has at most this many bytes; shorter than 254, so that COBS adds exactly one.
const uint8_t LARGEST_BODY = 80;
// COBS's byte and the final zero.
const uint8_t LARGEST_FRAME = LARGEST_BODY + 2;

// CRC-16/CCITT-FALSE (polynomial 0x1021, initial value 0xFFFF), a byte at a time without a table.
inline uint16_t crc16(const uint8_t *data, uint8_t length) {
  uint16_t crc = 0xFFFF;
  while (length--) {
#ifdef __AVR__
    crc = _crc_xmodem_update(crc, *data++); // the same in assembler
#else
    uint8_t x = crc >> 8 ^ *data++;
    x ^= x >> 4;
    crc = crc << 8 ^ x << 12 ^ x << 5 ^ x;
#endif
  }
  return crc;
}

// A body under construction.
struct FrameWriter {
  uint8_t body[LARGEST_BODY];
  uint8_t length = 0;

  template <typename T> void add(const T &value) {
    memcpy(body + length, &value, sizeof value);
    length += sizeof value;
  }

  // Append the CRC and encode the frame; return its length. The body is empty again after it.
  uint8_t encode(uint8_t *encoded) {
    add(crc16(body, length));
    uint8_t *code_at = encoded, *end = encoded + 1;
    for (const uint8_t *from = body, *last = body + length; from != last;) {
      uint8_t byte = *from++;
      if (byte) {
        *end++ = byte;
      } else {
        *code_at = end - code_at;
        code_at = end++;
      }
    }
    *code_at = end - code_at;
    *end++ = 0;
    length = 0;
    return end - encoded;
  }
};
