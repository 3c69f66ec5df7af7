"""Client of a display's telemetry, shared by recorder, live page and LSL outlet."""
