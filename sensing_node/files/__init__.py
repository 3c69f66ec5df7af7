"""Files of signals, one module a format; the table of formats is in `formats.py`."""
