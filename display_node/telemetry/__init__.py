"""Telemetry of a display: publisher, capture for recorders, terminal view."""
