"""Formats that cross a socket: messages, stream description, status."""
