"""The announcer: a process beside a sensing node that announces the node."""

import json
import logging
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict

from protocol.discovery.announcement import SERVICE, Announcement, announced_addresses, to_txt
from protocol.errors import DiscoveryError
from protocol.host.child_process import Sidecar, receive, run_as_sidecar
from protocol.security.link_keys import ServerKeys
from protocol.sockets import control_address

logger = logging.getLogger(__name__)


@contextmanager
def start_announcer(
    wanted: bool, address: str, stream: str, keys: ServerKeys | None
) -> Iterator[Callable[[], None]]:
    """Prepare the announcement of the node bound to `address`, within a `with`.

    Yields a function that begins the announcement; call it once the node's sockets are bound. It
    does nothing unless `wanted`. Raises DiscoveryError where there is no address to announce, and
    SidecarError where the process cannot start.
    """
    if not wanted:
        yield lambda: None
        return
    control_address(address)
    if not address.startswith("tcp://"):
        raise DiscoveryError(f"--announce: {address} is on this machine alone; bind tcp://*:5555")
    bound_to, _, port = address.removeprefix("tcp://").rpartition(":")
    bound_to = "127.0.0.1" if bound_to == "localhost" else bound_to
    host = socket.gethostname().partition(".")[0]
    key = None if keys is None else keys.pair.public.key
    node = json.dumps(asdict(Announcement.of_node(stream, host, int(port), key)))
    with Sidecar("announcer", "protocol.discovery.announcer", bound_to, node) as sidecar:
        yield lambda: sidecar.send(begin=True)


def main() -> None:
    """Announce the node after its first message, and withdraw the announcement when it ends."""
    bound_to, node = sys.argv[1:]
    announcement = Announcement(**json.loads(node))
    with run_as_sidecar() as ready:
        from protocol.discovery import browser

        addresses = announced_addresses(bound_to, browser.own_addresses())
        network = browser.open_multicast(addresses)
        ready(", ".join(addresses))
    if receive() is None:
        network.close()
        return
    info = browser.ServiceInfo(
        SERVICE,
        f"{announcement.name}.{SERVICE}",
        port=announcement.port,
        properties=to_txt(announcement),
        server=f"telepulse-{announcement.node}.local.",
        parsed_addresses=addresses,
    )
    try:
        # A name that is taken gets a number.
        network.register_service(info, allow_name_change=True)
    except browser.ZeroconfError as error:
        logger.error(f"cannot be announced: {type(error).__name__} {error}")
        raise SystemExit(1) from None
    name = info.name.removesuffix("." + SERVICE)
    logger.info(f"announced as {name!r} at {', '.join(addresses)}")
    receive()
    network.unregister_all_services()
    network.close()


if __name__ == "__main__":
    main()
