"""telepulse's own board for a step and direction carrier, with the film on the same cable."""
