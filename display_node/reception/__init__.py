"""Reception of the stream: connections, jitter buffer, playout clock, delay estimators."""
