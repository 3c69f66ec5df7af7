"""The options of discovery, and what they come to: a node that is announced, or found."""

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer
from rich.console import Console

from protocol.errors import DiscoveryError
from protocol.host.sidecar import Sidecar, start_sidecar
from protocol.security.keys import ServerKeys
from protocol.sockets import control_address

AnnounceOption = Annotated[
    bool,
    typer.Option(
        "--announce",
        help="Make this node known on the local network, for display-node --discover: its stream's"
        " and this machine's name, its ports and its key's fingerprint.",
    ),
]
DiscoverOption = Annotated[
    bool,
    typer.Option(
        "--discover",
        help="Find the sensing node on the local network, instead of --connect. Who it is is still"
        " told by --peer.",
    ),
]
NamedOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Of several that --discover finds, this one."),
]


class Announcer:
    """What announces a node, once its sockets are bound."""

    def __init__(self, companion: Sidecar | None) -> None:
        """None: nothing is announced."""
        self._companion = companion

    def begin(self) -> None:
        """Announce it, from now on until the node ends."""
        if self._companion is not None:
            self._companion.tell(begin=True)


@contextmanager
def start_announcer(
    program: str, wanted: bool, address: str, stream: str, keys: ServerKeys | None, console: Console
) -> Iterator[Announcer]:
    """Announce what is bound to `address`, where that is wanted, within a `with`.

    Raises DiscoveryError where there is nothing to announce, BesideError.
    """
    if not wanted:
        yield Announcer(None)
        return
    control_address(address)
    if not address.startswith("tcp://"):
        raise DiscoveryError(f"--announce: {address} is on this machine alone; bind tcp://*:5555")
    bound_to, _, port = address.removeprefix("tcp://").rpartition(":")
    words = {
        "bound_to": "127.0.0.1" if bound_to == "localhost" else bound_to,
        "port": int(port),
        "stream": stream,
        "host": socket.gethostname().partition(".")[0],
        "key": None if keys is None else keys.own.public.key.hex(),
    }
    module = "protocol.discovery.announcer"
    log = console.print
    with start_sidecar(program, "the announcer", module, json.dumps(words), log=log) as companion:
        yield Announcer(companion)
