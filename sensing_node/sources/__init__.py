"""Sources whose samples are known in advance, one file a kind: synthetic pulses and recordings."""
