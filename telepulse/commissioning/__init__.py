"""Checks of a bench before a finger is on it: its sensors, its drive, the model of its actuator."""
