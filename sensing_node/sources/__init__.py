"""Sources whose samples are known in advance: synthetic pulses and recordings."""
