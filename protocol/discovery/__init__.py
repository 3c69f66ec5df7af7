"""Discovery of sensing nodes on the local network by DNS-SD over multicast DNS (RFC 6762, 6763).

Anybody there can announce anything: an announcement gives addresses to try, and the keys alone
decide which node answers.
"""
