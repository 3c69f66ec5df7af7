"""`python -m benchmarks.peers [ROUNDS [MESSAGES]]`: run this benchmark alone."""

import sys

from benchmarks.peers import main

main(*map(int, sys.argv[1:]))
