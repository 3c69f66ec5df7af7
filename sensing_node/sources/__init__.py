"""Sources that know their samples ahead, one file a kind: synthetic pulses and recordings."""
