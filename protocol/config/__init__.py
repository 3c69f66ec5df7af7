"""Configuration: the scene file, and quantities with units."""
