"""Sidecar that serves a node's metrics: `python -m telepulse.metrics PROGRAM [ADDRESS:]PORT`."""

import os
import sys
import threading

from protocol.host.child_process import receive, run_as_sidecar


def main() -> None:
    """Serve until the node ends."""
    program, where = sys.argv[1:]
    with run_as_sidecar() as ready:
        # Imported here, so that a missing library is reported, too.
        from telepulse.metrics.server import MetricsServer, parse_address

        server = MetricsServer(program, *parse_address(where))
        ready(server.url)
    node = receive()
    if node is not None:
        threading.Thread(target=server.follow, args=(node["address"], node["key"])).start()
        receive()
    # Ends without waiting for threads that serve slow peers.
    os._exit(0)


main()
