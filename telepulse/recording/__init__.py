"""Recordings of a display: all that it received and did, in an MCAP file; export and report."""
