"""Clocks of two machines: exchanges, offset, skew, and the clocks of devices."""
