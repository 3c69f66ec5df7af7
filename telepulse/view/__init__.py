"""The live page: what a display feels and hears, in a browser."""
