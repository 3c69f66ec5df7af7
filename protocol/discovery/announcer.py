"""`python -m protocol.discovery.announcer`: announces the sensing node that it is beside."""

import json
import sys

from protocol.beside import beginning, say, told
from protocol.discovery.announcement import SERVICE, announced, to_txt
from protocol.discovery.networks import told_of


def main() -> None:
    """Announce once told to, until the node ends; then take it back."""
    words = json.loads(sys.argv[1])
    with beginning() as ready:
        from protocol.discovery import multicast

        addresses = told_of(words["bound_to"], *multicast.own_addresses())
        network = multicast.speaking_on(addresses)
        ready(", ".join(addresses))
    if told() is None:
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
    told()
    network.unregister_all_services()
    network.close()


main()
