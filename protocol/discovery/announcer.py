"""`python -m protocol.discovery.announcer`: announces the sensing node that it is beside."""

import json
import sys

from protocol.discovery.announcement import SERVICE, announced, announced_addresses, to_txt
from protocol.host.sidecar import receive, run_as_sidecar, say


def main() -> None:
    """Announce once told to, until the node ends; then take it back."""
    words = json.loads(sys.argv[1])
    with run_as_sidecar() as ready:
        from protocol.discovery import multicast

        addresses = announced_addresses(words["bound_to"], *multicast.own_addresses())
        network = multicast.speaking_on(addresses)
        ready(", ".join(addresses))
    if receive() is None:
        network.close()
        return
    key = None if words["key"] is None else bytes.fromhex(words["key"])
    node = announced(words["stream"], words["host"], words["port"], key)
    info = multicast.ServiceInfo(
        SERVICE,
        f"{node.name}.{SERVICE}",
        port=node.port,
        properties=to_txt(node),
        server=f"telepulse-{node.node}.local.",
        parsed_addresses=addresses,
    )
    try:
        # Where the name is taken, it gets a number.
        network.register_service(info, allow_name_change=True)
    except multicast.ZeroconfError as error:
        say(f"cannot be announced: {type(error).__name__} {error}")
        raise SystemExit(1) from None
    name = info.name.removesuffix("." + SERVICE)
    say(f"announced as {name!r} at {', '.join(addresses)}")
    receive()
    network.unregister_all_services()
    network.close()


main()
