"""Programs around the two nodes: simulation, demo, emulation, recordings, reports, commands."""
