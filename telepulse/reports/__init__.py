"""The studies of `telepulse study`."""
