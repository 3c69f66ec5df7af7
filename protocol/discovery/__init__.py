"""Discovery of sensing nodes on the local network by DNS-SD over multicast DNS (RFC 6762, 6763).

Anybody on the network can announce anything. An announcement is used only as addresses to try; the
keys authenticate the node.
"""
