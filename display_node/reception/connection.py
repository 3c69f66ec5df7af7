"""The display's sockets to its sensing node, connected and kept so.

ZeroMQ looks names up in the thread that moves all its messages, and a slow name server holds that
up for seconds. So a thread of ours looks them up, which lives only while it does; ZeroMQ is given
numbers.
"""

import itertools
import logging
import socket
import threading
import time
from collections.abc import Iterator, Sequence

import zmq

from display_node.reception.endpoint import ANSWER_NS, FLOODED_NS, Endpoint
from display_node.reception.failover import FOLLOWS_WITHIN_NS, DataPath
from protocol import sockets
from protocol.security.keys import ClientKeys
from protocol.security.socket_monitor import HandshakeMonitor
from protocol.summary_tables import Reconnections

logger = logging.getLogger(__name__)

LOOK_UP_AGAIN_S = 2.0


class Lookup:
    """Finds the number behind an address's name, beside the loop."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._said = ""
        self._lookups = 0
        self._found: str | None = None
        self._thread: threading.Thread | None = None

    @property
    def running(self) -> bool:
        """True while a look-up is under way."""
        return self._thread is not None and self._thread.is_alive()

    def start(self) -> None:
        """Look up; the outcome is there when `running` ends."""
        # A daemon: a name server that does not answer must not hold up the program's end.
        self._thread = threading.Thread(target=self._run, daemon=True)
        try:
            self._thread.start()
        except RuntimeError:
            # No thread is to be had: the loop goes on, and asks again.
            self._say(f"{self._address} cannot be looked up: no thread can be started; trying on")

    def take(self) -> str | None:
        """Return the address with a number for a name, once for each look-up that found one."""
        found, self._found = self._found, None
        return found

    def _run(self) -> None:
        if not self._address.startswith("tcp://"):
            self._found = self._address
            return
        host, _, port = self._address.removeprefix("tcp://").rpartition(":")
        try:
            found = socket.getaddrinfo(host.strip("[]"), port, type=socket.SOCK_STREAM)
        except OSError as error:
            self._say(f"{host} is not found: {error.strerror}; trying on")
            time.sleep(LOOK_UP_AGAIN_S)
            return
        # A name may stand for several numbers, not all of them reachable: one after the other.
        numbers = sorted({(family != socket.AF_INET, name[0]) for family, *_, name in found})
        is_ipv6, number = numbers[self._lookups % len(numbers)]
        self._lookups += 1
        number = f"[{number}]" if is_ipv6 else number
        self._found = f"tcp://{number}:{port}"

    def _say(self, text: str) -> None:
        if text != self._said:
            self._said = text
            logger.warning(text)


# How long to wait for the answer to a request to connect, at least `ANSWER_NS`: the kernel repeats
# it only after 1 s.
ANSWER_ROUND_TRIPS = 3
FLOOD = "flood"
# A silence of all lines for so long: control, too, is connected anew.
CUT_NS = 500_000_000
# Where this process itself stood still for so long, what it receives first has only queued.
STOOD_STILL_NS = 250_000_000


class Connection:
    """Control and data sockets of one stream, over one address or several.

    A path is a data socket, a TCP connection of its own; the addresses share out the paths.
    Control goes over one address at a time and moves on to the next when nothing is received.

    rejected: how often a connection was refused, by cause.
    """

    def __init__(
        self,
        context: sockets.Context,
        addresses: Sequence[str],
        paths: int,
        keys: ClientKeys | None = None,
    ) -> None:
        """paths: at least one for each address. Raises AddressError."""
        shares = [range(number, paths, len(addresses)) for number in range(len(addresses))]
        self.routes = [
            Path(context, address, len(share), keys)
            for address, share in zip(addresses, shares, strict=True)
        ]
        self._turns = itertools.cycle(self.routes)
        # What was last subscribed with.
        self._times_ns: tuple[int, int] | None = None
        self._received_ns: int | None = None
        self._polled_ns: int | None = None
        self._cut_ns = CUT_NS
        self._controls = 0
        self.control = Endpoint(sockets.unconnected(context, zmq.DEALER, keys))
        self._paths = [path for route in self.routes for path in route.paths]
        self._lines = [self.control, *(line for path in self._paths for line in path.lines)]
        self.descriptors = sockets.descriptors([line.socket for line in self._lines])
        self._refusals = HandshakeMonitor(context, keys)
        for line in self._lines:
            self._refusals.watch(line.socket)
        self.rejected = self._refusals.rejected
        # What was reported, once.
        self._flooded: set[str] = set()

    @property
    def reconnections(self) -> Reconnections:
        """Counts of connections made beside, or instead of, those that were silent."""
        opened = sum(path.failover.opened for path in self._paths)
        kept = sum(path.failover.kept for path in self._paths)
        return Reconnections(opened, kept, self._controls)

    def subscribe(self, frame_ns: int, round_trip_ns: int, now_ns: int) -> None:
        """Subscribe to frames; one frame covers `frame_ns`.

        round_trip_ns: time of a request to the sensing node and of its reply.
        """
        times_ns = frame_ns, max(ANSWER_NS, ANSWER_ROUND_TRIPS * round_trip_ns)
        if times_ns == self._times_ns:
            return
        first, self._times_ns = self._times_ns is None, times_ns
        for line in self._lines:
            line.answer_ns = times_ns[1]
        for path in self._paths:
            path.failover.set_timeouts(*times_ns)
            for line in path.lines:
                line.expect(1e9 / frame_ns)
            if first:
                path.subscribe(now_ns)

    def poll(self, now_ns: int) -> bool:
        """Connect what is silent, once its address is known; call each tick.

        Returns whether control has a new connection, over which nobody knows this display yet.
        """
        answered = self._refusals.poll(now_ns)
        for line in self._lines if answered else ():
            line.take_answer(answered)
        self._close_floods(now_ns)
        cut = self._cut(now_ns)
        for path in self._paths if cut else ():
            path.failover.give_up()
        for route in self.routes:
            route.poll(now_ns)
        introduce = self._ask_again(now_ns)
        if cut and self.control.address is not None:
            self._connect_control(self.control.address, now_ns)
            return True
        return introduce or (self.control.silent(now_ns) and self._move_control(now_ns))

    def _close_floods(self, now_ns: int) -> None:
        """Close for a while what brings more than any stream does."""
        until_ns = now_ns + FLOODED_NS
        for route in self.routes:
            for path in route.paths:
                if path.flooded(now_ns):
                    self._count_flood(path.close(until_ns), route.address)
        if self.control.flooded(now_ns):
            self._count_flood(self.control.close(until_ns), "control")

    def _count_flood(self, dropped: int, whose: str) -> None:
        self.rejected[FLOOD] += max(1, dropped)
        if whose not in self._flooded:
            self._flooded.add(whose)
            logger.warning(
                f"{whose} sends far more than a stream; closed for {FLOODED_NS // 10**9} s"
            )

    def _ask_again(self, now_ns: int) -> bool:
        """Replace the connection whose request was lost, when the other one's is answered.

        One of the two requests, control's or data's, was sent while the network was cut: it need
        not be waited for. Return whether control has a new connection.
        """
        control = self.control
        for path in self._paths:
            data = path.first
            if control.answered == data.answered or data.address is None:
                continue
            waits = control if data.answered else data
            if now_ns - waits.asked_ns < waits.answer_ns:
                continue
            if sockets.control_address(data.address) != control.address:
                continue
            if waits is data:
                data.connect(data.address, now_ns, fast_retry=False)
            else:
                # The early repetition may have been too early for this network.
                self._connect_control(control.address, now_ns, fast_retry=False)
                return True
        return False

    def _cut(self, now_ns: int) -> bool:
        """Return whether all lines together have been silent for too long; once in a silence."""
        stood_still = self._polled_ns is not None and now_ns - self._polled_ns >= STOOD_STILL_NS
        self._polled_ns = now_ns
        for path in self._paths if stood_still else ():
            path.failover.mark_suspect(now_ns)
        # Each is asked, and none twice.
        received = sum(path.take_received(now_ns) for path in self._paths)
        if received + self.control.received(now_ns):
            self._received_ns = now_ns
            self._cut_ns = FOLLOWS_WITHIN_NS if stood_still else CUT_NS
        elif self._received_ns is not None and now_ns - self._received_ns >= self._cut_ns:
            self._received_ns = None
            return True
        return False

    def _move_control(self, now_ns: int) -> bool:
        for route in itertools.islice(self._turns, len(self.routes)):
            address = route.paths[0].first.address
            if address is not None:
                self._connect_control(sockets.control_address(address), now_ns)
                return True
        return False

    def _connect_control(self, address: str, now_ns: int, fast_retry: bool = True) -> None:
        self._controls += self.control.address is not None
        self.control.connect(address, now_ns, fast_retry)


class Path:
    """One address of the sensing node and the data paths that are connected to it.

    won: frames whose first copy came this way.
    """

    def __init__(
        self,
        context: sockets.Context,
        address: str,
        paths: int,
        keys: ClientKeys | None = None,
    ) -> None:
        """Open the data paths. Raises AddressError when `address` is none."""
        sockets.control_address(address)
        self.address = address
        self.paths = [DataPath(context, keys) for _ in range(paths)]
        self._lookup = Lookup(address)
        self.won = 0

    def messages(self) -> Iterator[bytes]:
        """Yield the messages that wait."""
        for path in self.paths:
            yield from path.messages()

    def poll(self, now_ns: int) -> None:
        """Look the address up while nothing is received from it, and connect to what is found."""
        found = None if self._lookup.running else self._lookup.take()
        wanted = False
        for path in self.paths:
            wanted |= path.poll(now_ns, found)
        if wanted and found is None and not self._lookup.running:
            self._lookup.start()
