"""`python -m telepulse.emulator`: the relay of an emulated link, as a process of its own."""

import sys

from telepulse.emulator.relay import main

main(sys.argv[1:])
