"""`python -m telepulse.metrics PROGRAM [ADDRESS:]PORT`: serves a node's metrics beside it."""

import os
import sys
import threading

from protocol.host.sidecar import receive, run_as_sidecar
from telepulse.metrics.server import parse_address


def main() -> None:
    """Serve until the node ends."""
    program, where = sys.argv[1:]
    with run_as_sidecar() as ready:
        address = parse_address(where)
        from telepulse.metrics.server import Server

        server = Server(program, *address)
        ready(server.url)
    node = receive()
    if node is not None:
        threading.Thread(target=server.follow, args=(node["address"], node["key"])).start()
        receive()
    # Its threads have nothing to finish, and some wait for who asked.
    os._exit(0)


main()
