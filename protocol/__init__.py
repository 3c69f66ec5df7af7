"""What both nodes agree on: the wire, the clock, the tactile model, the scene file."""
