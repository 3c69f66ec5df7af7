"""`python -m telepulse.metrics PROGRAM [ADDRESS:]PORT`: serves a node's metrics beside it."""

import os
import sys
import threading

from protocol.beside import beginning, told
from telepulse.metrics.address import parse_address


def main() -> None:
    """Serve until the node ends."""
    program, where = sys.argv[1:]
    with beginning() as ready:
        address = parse_address(where)
        from telepulse.metrics.server import Server

        server = Server(program, *address)
        ready(server.url)
    node = told()
    if node is not None:
        threading.Thread(target=server.follow, args=(node["address"], node["key"])).start()
        told()
    # Its threads have nothing to finish, and some wait for who asked.
    os._exit(0)


main()
