"""`python -m telepulse.metrics PROGRAM [ADDRESS:]PORT`: serves a node's metrics beside it."""

import os
import sys
import threading

from protocol.host.sidecar import receive, run_as_sidecar


def main() -> None:
    """Serve until the node ends."""
    program, where = sys.argv[1:]
    with run_as_sidecar() as ready:
        # Here, as a library that is missing is to be reported, too.
        from telepulse.metrics.server import Server, parse_address

        server = Server(program, *parse_address(where))
        ready(server.url)
    node = receive()
    if node is not None:
        threading.Thread(target=server.follow, args=(node["address"], node["key"])).start()
        receive()
    # Its threads have nothing to finish, and some wait for who asked.
    os._exit(0)


main()
