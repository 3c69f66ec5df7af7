"""Summary of a run: figures in `tables.py`, and in `figures.toml` what they mean and look like."""
