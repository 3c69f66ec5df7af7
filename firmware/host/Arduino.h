// What the sketch uses of Arduino's core, where it is compiled for this machine: see host.h.
#pragma once

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <type_traits>

// As Arduino's macros, which take operands of two types.
template <typename A, typename B> constexpr std::common_type_t<A, B> min(A a, B b) {
  return a < b ? a : b;
}
template <typename A, typename B> constexpr std::common_type_t<A, B> max(A a, B b) {
  return a > b ? a : b;
}
inline float constrain(float value, float least, float most) {
  return value < least ? least : value > most ? most : value;
}

void noInterrupts();
void interrupts();
uint32_t micros();
