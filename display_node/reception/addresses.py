"""Addresses of the sensing node: announcements on the local network, and look-up of host names.

ZeroMQ would look up host names in the thread that moves all its messages, which a slow name server
delays by seconds. So each look-up runs in a thread of its own (decision 6), and ZeroMQ receives IP
addresses only.
"""

import ipaddress
import json as json_format
import logging
import math
import socket
import threading
import time
from pathlib import Path
from typing import Any

from rich.console import Console

from protocol.discovery.announcement import Announcement, fingerprint, matching, only_match
from protocol.errors import DiscoveryError, ProtectionError
from protocol.host.output import write_whole
from protocol.security.keys import PublicKey
from protocol.sockets import tcp_address

logger = logging.getLogger(__name__)

# Time for further matches after the first one: several are refused as ambiguous.
GATHER_S = 2.0
# A search that takes longer is logged once.
LOG_AFTER_S = 5.0
LOOK_EVERY_S = 0.05


def discovered(name: str | None, peer: PublicKey | None, seconds: float | None) -> list[str]:
    """Return the addresses of the one sensing node that announces itself on this network.

    name, peer: the node's name and public key; None accepts any. seconds: longest wait; None for no
    limit. Raises DiscoveryError where several nodes match or none is found in time, and
    ProtectionError where the node requires keys and `peer` is None.
    """
    # Imported here: only this function needs the zeroconf library.
    from protocol.discovery.browser import Browser

    known = None if peer is None else fingerprint(peer.key)
    with Browser() as look:
        logger.info("looking for a sensing node on the local network")
        begin_s, logged = time.monotonic(), False
        while not matching(look.found, name, known):
            waited_s = time.monotonic() - begin_s
            if waited_s > (math.inf if seconds is None else seconds):
                raise DiscoveryError(f"within {seconds:g} s {_others(look.found)}")
            if waited_s > LOG_AFTER_S and not logged:
                logged = True
                logger.info(f"so far {_others(look.found)}; waiting on")
            time.sleep(LOOK_EVERY_S)
        if name is None:
            time.sleep(GATHER_S)
        one = only_match(matching(look.found, name, known))
        refused = look.refused.total()
    if refused:
        logger.warning(f"{refused} announcements were not valid")
    if one.fingerprint is not None and peer is None:
        raise ProtectionError(
            f"{one.name!r} requires keys; give --key keys/NAME.key --peer keys/PEER.pub"
        )
    addresses = [tcp_address((address, one.port)) for address in one.addresses]
    logger.info(f"found {one.name!r} at {', '.join(addresses)}")
    return addresses


LISTED_S = 4.0


def list_nodes(seconds: float | None, console: Console, json: Path | None) -> None:
    """Print the sensing nodes that announce themselves within `seconds` (4 s where None).

    Raises DiscoveryError, and OutputError where `json` cannot be written.
    """
    from protocol.discovery.browser import Browser

    with Browser() as look:
        time.sleep(LISTED_S if seconds is None else seconds)
        found, refused = sorted(look.found, key=lambda one: one.name), look.refused
    rows: list[dict[str, Any]] = [
        {
            "name": one.name,
            "stream": one.stream,
            "addresses": [tcp_address((address, one.port)) for address in one.addresses],
            "key": one.fingerprint,
            "node": one.node,
        }
        for one in found
    ]
    for row in rows:
        key = row["key"] or "none: any display may connect"
        addresses = " ".join(row["addresses"])
        what = f"stream {row['stream']!r}, key {key}, node {row['node']}"
        console.print(f"{row['name']!r} at {addresses}: {what}")
    causes = ", ".join(f"{count} {cause}" for cause, count in sorted(refused.items()))
    console.print(f"{len(rows)} sensing nodes announced; refused: {causes or 'nothing'}")
    if json is not None:
        table = {"nodes": rows, "refused": dict(refused)}
        write_whole(json, json_format.dumps(table, indent=2) + "\n")


def _others(found: list[Announcement]) -> str:
    if not found:
        return "no sensing node has announced itself: start it with --announce"
    names = ", ".join(repr(one.name) for one in found)
    return f"no announced sensing node has the requested name and key; announced are: {names}"


LOOK_UP_AGAIN_S = 2.0
STREAM = socket.SOCK_STREAM


class Lookup:
    """Look-up of the host name in an address such as tcp://host:5555, in a thread of its own."""

    def __init__(self, address: str) -> None:
        self._address = address
        # Why the last look-up failed; empty after a successful one.
        self.failure = ""
        self._logged = ""
        self._lookups = 0
        self._found: str | None = None
        self._thread: threading.Thread | None = None

    @property
    def running(self) -> bool:
        """True while a look-up is under way."""
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Start a look-up; `take` returns its result once `running` is False."""
        # A daemon: a name server that does not answer must not hold up the program's end.
        self._thread = threading.Thread(target=self._run, daemon=True)
        try:
            self._thread.start()
        except RuntimeError:
            # The system refuses another thread: the loop continues and tries again.
            self._warn(f"{self._address} cannot be looked up: no thread can be started; retrying")

    def take(self) -> str | None:
        """Return the address with an IP address as its host, once for each successful look-up."""
        found, self._found = self._found, None
        return found

    def _run(self) -> None:
        scheme, _, place = self._address.partition("://")
        if scheme != "tcp":
            self._found = self._address
            return
        host, _, port = place.rpartition(":")
        failure = _zone_fault(host.strip("[]"), port)
        found: list[tuple[Any, ...]] = []
        try:
            found = [] if failure else socket.getaddrinfo(host.strip("[]"), port, type=STREAM)
        except OSError as error:
            failure = f"{host} is not found: {error.strerror}"
        if failure:
            self.failure = failure
            self._warn(f"{self.failure}; retrying")
            time.sleep(LOOK_UP_AGAIN_S)
            return
        self.failure = ""
        # A name may have several IP addresses, not all of them reachable: they are tried in turn.
        places = sorted({(family != socket.AF_INET, place) for family, *_, place in found})
        self._found = tcp_address(places[self._lookups % len(places)][1])
        self._lookups += 1

    def _warn(self, text: str) -> None:
        if text != self._logged:
            self._logged = text
            logger.warning(text)


def _zone_fault(host: str, port: str) -> str:
    """Return what is wrong with the interface of an IPv6 address, and those here; empty if none.

    An address of one link alone means another host at each interface.
    """
    plain, _, zone = host.partition("%")
    try:
        is_link_local = ipaddress.IPv6Address(plain).is_link_local
    except ValueError:
        return ""
    interfaces = {str(number): name for number, name in socket.if_nameindex()}
    if zone in interfaces or zone in interfaces.values() or not (zone or is_link_local):
        return ""
    lacks = f"no interface here is named {zone}" if zone else "lacks the interface that leads there"
    names = list(interfaces.values())
    example = next((name for name in names if not name.startswith("lo")), "eth0")
    return (
        f"[{host}] {lacks}: write tcp://[{plain}%{example}]:{port} or the like; interfaces here:"
        f" {', '.join(names)}"
    )
