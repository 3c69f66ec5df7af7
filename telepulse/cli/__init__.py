"""The command line of telepulse, one file for each command."""
