"""Live page: the state of a display in a browser."""
