"""Real sensors: what serial ports, CAN buses and Lab Streaming Layer bring, as samples of force.

Both nodes read them: the sensing node its pulse, the display node its feedback film.
"""
