"""Recordings: all that a display heard and did, in an MCAP file; played again, exported."""
