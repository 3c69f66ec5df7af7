"""Actuators, one file a kind."""
