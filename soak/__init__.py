"""The soak: both nodes as real processes under random faults for a stated time, and a verdict.

`python -m soak` runs it. It is not part of the installed package.
"""
