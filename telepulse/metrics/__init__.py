"""A node's figures for Prometheus, from a process beside it."""
