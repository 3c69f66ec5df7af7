"""The display node: stream → playout → prediction → strain target → force loop → actuator."""
