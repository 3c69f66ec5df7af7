// Uno, Nano and other ATmega328P boards at 16 MHz. The pins are those of a CNC shield V3, axis X.
// See board.h.
#pragma once

#include <avr/io.h>
#include <avr/wdt.h>

// 500 processor cycles from tick to tick.
const uint32_t TICK_HZ = 32000;
// Three bytes: at this tick, rates of a 500th of a step a second differ.
typedef __uint24 phase_t;
const uint32_t LAST_PHASE = 0xFFFFFF;
// A conversion takes 52 us, so that one every other tick gives 16 of 10 bits a millisecond.
const uint16_t FILM_FULL_SCALE = 16 * 1023;
const char CHIP_NAME[] = "ATmega328P";

// Not cleared by a reset.
#define KEPT_OVER_RESET __attribute__((section(".noinit")))

// In the interrupt a call would save all registers, which takes longer than the rest.
#define IN_PLACE static inline __attribute__((always_inline))

// D2 step, D5 direction, D8 enable (low: on), D9 home switch, D10 fault, A0 film.
IN_PLACE void pin_step(bool high) {
  if (high) PORTD |= _BV(PD2);
  else PORTD &= (uint8_t)~_BV(PD2);
}
IN_PLACE void pin_direction(bool high) {
  if (high) PORTD |= _BV(PD5);
  else PORTD &= (uint8_t)~_BV(PD5);
}
inline void pin_enable(bool on) {
  if (on) PORTB &= (uint8_t)~_BV(PB0);
  else PORTB |= _BV(PB0);
}
inline bool pin_home() { return PINB & _BV(PB1); }
inline bool pin_fault() { return PINB & _BV(PB2); }
// The rest of the tick takes longer than the 1.9 us that a DRV8825 needs.
IN_PLACE void wait_for_pulse() {}

uint8_t mcu_status KEPT_OVER_RESET;
volatile uint16_t film_halves[2];
uint16_t film_sum;

// A watchdog that has reset the processor runs on with 15 ms, and must end before main() begins.
void stop_watchdog() __attribute__((naked, used, section(".init3")));
void stop_watchdog() {
  mcu_status = MCUSR;
  MCUSR = 0;
  wdt_disable();
}

ISR(TIMER1_COMPA_vect) {
  stepper_tick();
  if (ticks_left & 1) {
    film_sum += ADC;
    ADCSRA |= _BV(ADSC);
    if ((ticks_left & 15) == 1) {
      film_halves[ticks_left == 1] = film_sum;
      film_sum = 0;
    }
  }
}

// The line. Arduino's Serial takes 200 cycles a byte sent, of 320, and so half of the processor.
// A sketch that does not name Serial is linked without it.
uint8_t received[128], sent[128];
const uint8_t LINE_MASK = 127;
volatile uint8_t received_head = 0, received_tail = 0, sent_head = 0, sent_tail = 0;

ISR(USART_RX_vect) {
  uint8_t head = received_head;
  received[head] = UDR0;
  received_head = (head + 1) & LINE_MASK;
}

ISR(USART_UDRE_vect) {
  uint8_t tail = sent_tail;
  UDR0 = sent[tail];
  sent_tail = tail = (tail + 1) & LINE_MASK;
  if (tail == sent_head) UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
}

inline int16_t board_read() {
  uint8_t tail = received_tail;
  if (tail == received_head) return -1;
  received_tail = (tail + 1) & LINE_MASK;
  return received[tail];
}

inline uint8_t board_writable() { return (sent_tail - sent_head - 1) & LINE_MASK; }

inline void board_write(const uint8_t *bytes, uint8_t count) {
  while (board_writable() < count) {}
  uint8_t head = sent_head;
  while (count--) {
    sent[head] = *bytes++;
    head = (head + 1) & LINE_MASK;
  }
  sent_head = head;
  UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0) | _BV(UDRIE0);
}

inline void board_begin(uint32_t baud) {
  PORTB |= _BV(PB0) | _BV(PB1) | _BV(PB2); // motor off, pull-ups for the switch and the fault
  DDRB |= _BV(PB0);
  DDRD |= _BV(PD2) | _BV(PD5);
  ADMUX = _BV(REFS0);
  ADCSRA = _BV(ADEN) | _BV(ADSC) | _BV(ADPS2) | _BV(ADPS1); // 16 MHz / 64
  UCSR0A = _BV(U2X0);
  UBRR0 = F_CPU / 8 / baud - 1;
  UCSR0C = _BV(UCSZ01) | _BV(UCSZ00);
  UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
  TCCR1A = 0;
  TCCR1B = _BV(WGM12) | _BV(CS10);
  OCR1A = F_CPU / TICK_HZ - 1;
  TIMSK1 = _BV(OCIE1A);
  wdt_enable(WDTO_30MS);
}

inline void board_film(uint16_t *halves) {
  noInterrupts();
  halves[0] = film_halves[0];
  halves[1] = film_halves[1];
  interrupts();
}

inline void board_alive() { wdt_reset(); }

inline uint8_t board_reset_cause() {
  if (mcu_status & _BV(PORF)) return RESET_POWER_UP;
  if (mcu_status & _BV(BORF)) return RESET_BROWN_OUT;
  if (mcu_status & _BV(WDRF)) return RESET_WATCHDOG;
  return mcu_status & _BV(EXTRF) ? RESET_PIN : RESET_UNKNOWN;
}
