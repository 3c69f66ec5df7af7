"""`python -m telepulse`: the command line of telepulse."""

from telepulse.cli.main import main

main()
