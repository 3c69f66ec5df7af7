// A decoder of the host's frames: see telepulse_frames.h.
#pragma once

#include "telepulse_frames.h"

struct FrameReader {
  uint8_t body[LARGEST_BODY + 1];
  // Bytes of the decoded body, without its CRC.
  uint8_t length = 0;
  // Frames that were refused, modulo 256.
  uint8_t rejected = 0;

  // Take a byte. Return whether it ends a correct frame, which `body` then holds.
  bool take(uint8_t byte) {
    if (byte) {
      if (received < sizeof body) body[received++] = byte;
      else too_long = true;
      return false;
    }
    uint8_t count = received;
    bool whole = !too_long && decode(count);
    rejected += count && !whole;
    received = 0;
    too_long = false;
    return whole;
  }

  // Read the field at `at`, and advance `at`.
  template <typename T> T read(uint8_t &at) const {
    T value;
    memcpy(&value, body + at, sizeof value);
    at += sizeof value;
    return value;
  }

private:
  uint8_t received = 0;
  bool too_long = false;

  // Decode in place, as the decoded bytes are never ahead of the encoded ones.
  bool decode(uint8_t count) {
    uint8_t end = 0;
    for (uint8_t i = 0; i < count;) {
      uint8_t code = body[i++];
      if (code - 1 > count - i) return false;
      for (uint8_t copied = 1; copied < code; copied++) body[end++] = body[i++];
      if (i < count) body[end++] = 0;
    }
    if (end < 3) return false;
    length = end - 2;
    return (body[end - 2] | (uint16_t)body[end - 1] << 8) == crc16(body, length);
  }
};
