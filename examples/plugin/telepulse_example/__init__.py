"""A plug-in for telepulse with one kind of each group; no device is needed."""
