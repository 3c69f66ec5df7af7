"""Studies: computations about the system, each with a report."""
