"""The sensing node: sensor → calibrated force → stream."""
