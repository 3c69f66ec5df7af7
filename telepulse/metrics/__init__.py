"""Metrics of a node for Prometheus, served by a process beside it."""
