"""The soak: both nodes as real processes for a stated time, with faults at random from a seed, and
a verdict at the end. `python -m soak` runs it; not part of the package that is installed.
"""
