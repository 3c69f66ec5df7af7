// The film during a part of a search for home: whether its motion presses the finger or leaves it.
// No search has shown the motor's direction by then, and nothing else can.
//
// Readings are trusted once they are SETTLING_MS old, so that those of a wire that is being torn
// off are not.
#pragma once

#include "board.h"

class FilmTrend {
public:
  // Set the film's limits, and whether its counts fall where it is pressed.
  void scale(uint16_t least, uint16_t most, bool falls_pressed) {
    falls = falls_pressed;
    bool unused = !least && most > FILM_FULL_SCALE;
    share = unused ? 0 : max((most - least) / SHARES, 1);
  }

  void begin(uint16_t film) {
    began = least = trusted = waiting = newest = force(film);
    age_ms = 0;
  }

  // Take the reading of another millisecond.
  void add(uint16_t film) {
    newest = force(film);
    if (++age_ms < SETTLING_MS) return;
    age_ms = 0;
    trusted = waiting;
    waiting = newest;
    least = min(least, trusted);
  }

  bool fell() const { return share && trusted + share < began; }
  bool rose() const { return share && trusted > least + share; }
  // Four times what shows a direction, as the finger moves too; and less than at the beginning is
  // no press, however it rises.
  bool presses() const { return share && trusted > least + 4 * share && !fell(); }
  // No motion of a millisecond does this.
  bool jumps(uint16_t film) const {
    int32_t change = force(film) - newest;
    return share && (change > 4 * share || -change > 4 * share);
  }

private:
  static const uint8_t SETTLING_MS = 4, SHARES = 64;

  int32_t force(uint16_t film) const { return falls ? -(int32_t)film : film; }

  bool falls = false;
  // A share of the range between the film's limits; 0 where they are switched off.
  int32_t share = 0;
  int32_t began, least, trusted, waiting, newest;
  uint8_t age_ms;
};
