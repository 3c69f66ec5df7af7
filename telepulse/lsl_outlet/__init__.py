"""Outlet of a display's telemetry as Lab Streaming Layer streams."""
