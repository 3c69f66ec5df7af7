"""A display's telemetry as Lab Streaming Layer streams."""
