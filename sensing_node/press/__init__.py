"""The second drive: set-points of a distant finger press the probe at the wrist."""
