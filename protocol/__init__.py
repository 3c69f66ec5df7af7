"""Definitions that both nodes share: the wire, the clock, the tactile model, the scene file."""
