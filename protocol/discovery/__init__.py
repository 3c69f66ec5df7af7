"""Sensing nodes make themselves known on the local network, and are found there, by DNS-SD.

Names and addresses are all that is believed of it, and of them only where to knock: who opens is a
matter of keys.
"""
