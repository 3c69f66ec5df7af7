"""Summary of a run: figures in `fields.py`, and in `figures.toml` what they mean and look like."""
