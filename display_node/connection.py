"""The display's sockets to its sensing node, connected and kept so.

ZeroMQ looks names up in the thread that moves all its messages, and a slow name server holds that
up for seconds. So names are looked up here, by a thread that lives only while one is looked up,
which is while nothing is felt; ZeroMQ is given numbers.
"""

import socket as plain
import threading
import time
from collections.abc import Callable

import zmq

from protocol import sockets

RECONNECT_EVERY_NS = 2_000_000_000
CHECK_EVERY_NS = 10_000_000


class Connection:
    """Control and data sockets of one stream; `paths` data sockets, each a TCP connection."""

    def __init__(
        self, context: sockets.Context, address: str, paths: int, log: Callable[[str], None]
    ) -> None:
        """Raises AddressError when `address` is none."""
        sockets.control_address(address)
        self._lookup = Lookup(address, log)
        self._connected: str | None = None
        self._next_ns = 0
        self._subscribed = False
        self.control = sockets.unconnected(context, zmq.DEALER)
        self.data = [sockets.unconnected(context, zmq.SUB) for _ in range(paths)]
        self.all = [self.control, *self.data]

    def subscribe(self) -> None:
        """Ask for frames, from now on."""
        if not self._subscribed:
            self._subscribed = True
            for socket in self.data:
                socket.subscribe(b"")

    def tend(self, now_ns: int, silent: bool) -> None:
        """Connect once the address is known, and anew while nothing is heard; call each tick."""
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + CHECK_EVERY_NS
        if self._lookup.running:
            return
        found = self._lookup.take()
        if found is not None:
            self._connect(found)
            self._next_ns = now_ns + RECONNECT_EVERY_NS
        elif silent:
            self._lookup.start()
        else:
            self._next_ns = now_ns + RECONNECT_EVERY_NS

    def _connect(self, address: str) -> None:
        old, self._connected = self._connected, address
        for socket in self.data:
            sockets.reconnect(socket, old, address)
        old_control = None if old is None else sockets.control_address(old)
        sockets.reconnect(self.control, old_control, sockets.control_address(address))


class Lookup:
    """Finds the number behind an address's name, beside the loop."""

    def __init__(self, address: str, log: Callable[[str], None]) -> None:
        self._address = address
        self._log = log
        self._said = ""
        self._lookups = 0
        self._found: str | None = None
        self._thread: threading.Thread | None = None

    @property
    def running(self) -> bool:
        """Whether a look-up is under way."""
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Look up; the outcome is there when `running` ends."""
        # A daemon: a name server that does not answer must not hold up the program's end.
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def take(self) -> str | None:
        """The address with a number for a name, once for each look-up that found one."""
        found, self._found = self._found, None
        return found

    def _run(self) -> None:
        if not self._address.startswith("tcp://"):
            self._found = self._address
            return
        host, _, port = self._address.removeprefix("tcp://").rpartition(":")
        try:
            found = plain.getaddrinfo(host.strip("[]"), port, type=plain.SOCK_STREAM)
        except OSError as error:
            self._say(f"{host} is not found: {error.strerror}; trying on")
            time.sleep(RECONNECT_EVERY_NS * 1e-9)
            return
        # A name may stand for several numbers, not all of them reachable: one after the other.
        numbers = sorted({(family != plain.AF_INET, name[0]) for family, *_, name in found})
        is_ipv6, number = numbers[self._lookups % len(numbers)]
        self._lookups += 1
        number = f"[{number}]" if is_ipv6 else number
        self._found = f"tcp://{number}:{port}"

    def _say(self, text: str) -> None:
        if text != self._said:
            self._said = text
            self._log(text)
