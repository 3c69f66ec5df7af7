"""`python -m tests.support.netem`: the forwarder of an emulated link, as a process of its own."""

import sys

from tests.support.netem.forwarder import main

main(sys.argv[1:])
