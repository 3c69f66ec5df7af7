"""The sensing node: from a sensor to calibrated force and its stream."""
