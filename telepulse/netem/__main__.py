"""`python -m telepulse.netem`: the forwarder of an emulated link, as a process of its own."""

import sys

from telepulse.netem.forwarder import main

main(sys.argv[1:])
