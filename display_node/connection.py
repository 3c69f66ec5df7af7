"""The display's sockets to its sensing node, connected and kept so.

ZeroMQ looks names up in the thread that moves all its messages, and a slow name server holds that
up for seconds. So names are looked up here, by a thread that lives only while one is looked up,
which is while nothing is heard from its address; ZeroMQ is given numbers.
"""

import itertools
import socket as plain
import threading
import time
from collections.abc import Callable, Iterator, Sequence

import zmq

from protocol import sockets
from protocol.keys import ClientKeys
from protocol.refusals import Refusals

PATIENCE_NS = 2_000_000_000
# Nothing from anywhere for so long: the network is cut, and what TCP would repeat when it is back
# comes later than what a new connection brings.
CUT_NS = 500_000_000
# Where this process itself stood still for so long, it hears first what has queued meanwhile, which
# takes so long to come in; a connection is dead if no more follows that.
STOOD_STILL_NS = 250_000_000
COMES_IN_WITHIN_NS = 50_000_000
FOLLOWS_WITHIN_NS = 150_000_000
# How long to wait for the answer to a request to connect: the kernel repeats it only after 1 s.
# The network may be slower than it was: for 20 s it is hurried, then there is once all the time
# that it takes.
ANSWER_NS = 100_000_000
ANSWER_ROUND_TRIPS = 3
HURRIED_TRIES = 10
PATIENCE_FRAMES = 3
LOOK_UP_AGAIN_S = 2.0


class Connection:
    """Control and data sockets of one stream, over one address or several.

    A path is a data socket, a TCP connection of its own; the addresses share out the paths.
    Control goes over one address at a time and moves on to the next when it hears nothing.

    rejected: how often a connection was refused, by cause.
    """

    def __init__(
        self,
        context: sockets.Context,
        addresses: Sequence[str],
        paths: int,
        log: Callable[[str], None],
        keys: ClientKeys | None = None,
    ) -> None:
        """paths: at least one for each address. Raises AddressError."""
        shares = [range(number, paths, len(addresses)) for number in range(len(addresses))]
        self.routes = [
            Route(context, address, len(share), log, keys)
            for address, share in zip(addresses, shares, strict=True)
        ]
        self._turns = itertools.cycle(self.routes)
        # What was last subscribed with.
        self._times_ns: tuple[int, int] | None = None
        self._heard_ns: int | None = None
        self._tended_ns: int | None = None
        self._cut_ns = CUT_NS
        self.control = Line([sockets.unconnected(context, zmq.DEALER, keys)], hurried=True)
        self._lines = [self.control, *(route.data for route in self.routes)]
        data = [socket for route in self.routes for socket in route.data.sockets]
        self.descriptors = sockets.descriptors([*self.control.sockets, *data])
        self._refusals = Refusals(context, keys, log)
        for socket in (*self.control.sockets, *data):
            self._refusals.watch(socket)
        self.rejected = self._refusals.rejected

    def subscribe(self, frame_ns: int, round_trip_ns: int) -> None:
        """Ask for frames, from now on; one covers `frame_ns`. The way to the sensing node and
        back takes `round_trip_ns`."""
        times_ns = frame_ns, max(ANSWER_NS, ANSWER_ROUND_TRIPS * round_trip_ns)
        if times_ns == self._times_ns:
            return
        first, self._times_ns = self._times_ns is None, times_ns
        for line in self._lines:
            line.answer_ns = times_ns[1]
        for route in self.routes:
            route.data.be_patient_for(PATIENCE_FRAMES * frame_ns)
            if first:
                route.data.subscribe()

    def tend(self, now_ns: int) -> bool:
        """Connect what is silent, once its address is known; call each tick.

        Returns whether control has a new connection, over which nobody knows this display yet.
        """
        answered = self._refusals.tend(now_ns)
        for line in self._lines if answered else ():
            line.take_answers(answered)
        cut = self._cut(now_ns)
        for route in self.routes:
            if cut:
                route.data.give_up()
            route.tend(now_ns)
        told = self._tell(now_ns)
        if cut and self.control.address is not None:
            self.control.connect(self.control.address, now_ns)
            return True
        return told or (self.control.silent(now_ns) and self._move_control(now_ns))

    def _tell(self, now_ns: int) -> bool:
        """Where one request of control and data is answered, the other, sent while the network was
        cut, need not be waited for. Returns whether control has a new connection."""
        control = self.control
        for route in self.routes:
            data = route.data
            if control.answered == data.answered or data.address is None:
                continue
            waits = control if data.answered else data
            if now_ns - waits.asked_ns < waits.answer_ns:
                continue
            if sockets.control_address(data.address) != control.address:
                continue
            if waits is data:
                data.connect(data.address, now_ns)
            else:
                # It may have been too hurried for this network.
                control.connect(control.address, now_ns, hurried=False)
                return True
        return False

    def _cut(self, now_ns: int) -> bool:
        """Whether all lines together have just been silent for too long; once in a silence."""
        stood_still = self._tended_ns is not None and now_ns - self._tended_ns >= STOOD_STILL_NS
        self._tended_ns = now_ns
        if stood_still:
            for route in self.routes:
                route.data.doubt(now_ns)
        if sum(line.heard(now_ns) for line in self._lines):
            self._heard_ns = now_ns
            self._cut_ns = FOLLOWS_WITHIN_NS if stood_still else CUT_NS
        elif self._heard_ns is not None and now_ns - self._heard_ns >= self._cut_ns:
            self._heard_ns = None
            return True
        return False

    def _move_control(self, now_ns: int) -> bool:
        for route in itertools.islice(self._turns, len(self.routes)):
            if route.data.address is not None:
                self.control.connect(sockets.control_address(route.data.address), now_ns)
                return True
        return False


class Route:
    """One address of the sensing node and the data sockets that are connected to it.

    won: frames whose first copy came this way.
    """

    def __init__(
        self,
        context: sockets.Context,
        address: str,
        paths: int,
        log: Callable[[str], None],
        keys: ClientKeys | None = None,
    ) -> None:
        """Raises AddressError when `address` is none."""
        sockets.control_address(address)
        self.address = address
        data = [sockets.unconnected(context, zmq.SUB, keys) for _ in range(paths)]
        self.data = Line(data, hurried=False)
        self._lookup = Lookup(address, log)
        self.won = 0

    def tend(self, now_ns: int) -> None:
        """Look the address up while nothing is heard from it, and connect to what is found."""
        if self._lookup.running:
            return
        found = self._lookup.take()
        if found is not None:
            self.data.connect(found, now_ns)
        elif self.data.silent(now_ns):
            self._lookup.start()


class Line:
    """Sockets that are connected to one address together, and anew when all of them are silent.

    address: what they are connected to; None before that. answer_ns: when to repeat a request to
    connect that nobody answers. asked_ns: when the present ones were made. answered: whether one
    of them was.
    """

    def __init__(self, connected: list[sockets.Socket], hurried: bool) -> None:
        """hurried: requests to connect are repeated soon even before anything was ever heard, when
        nobody knows how long an answer takes."""
        self.sockets = connected
        self.address: str | None = None
        self.answer_ns = ANSWER_NS
        self.asked_ns = 0
        self.answered = False
        self._hurried = hurried
        self._patience_ns, self._follows_ns = PATIENCE_NS, FOLLOWS_WITHIN_NS
        self._in_doubt_until_ns = 0
        self._known = False
        self._tries = 0
        self._heard = self._asked = False
        self._silent_ns = 0

    def messages(self) -> Iterator[bytes]:
        """The messages that wait."""
        for socket in self.sockets:
            for message in sockets.receive_each(socket):
                self._heard = True
                yield message

    def subscribe(self) -> None:
        """Ask for all that is published, and be patient until it comes."""
        for socket in self.sockets:
            socket.subscribe(b"")
        self._asked = True

    def be_patient_for(self, least_ns: int) -> None:
        """Its messages may be so long apart."""
        self._patience_ns = max(PATIENCE_NS, least_ns)
        self._follows_ns = max(FOLLOWS_WITHIN_NS, least_ns)

    def doubt(self, now_ns: int) -> None:
        """This process stood still: what comes in now may be of a connection that died meanwhile,
        for which TCP would wait as long as the network was cut."""
        if self._tries == 0:
            self._in_doubt_until_ns = now_ns + COMES_IN_WITHIN_NS
            self._silent_ns = min(self._silent_ns, now_ns + self._follows_ns)

    def heard(self, now_ns: int) -> bool:
        """Whether anything has come since this was asked last."""
        heard = self._heard
        if heard:
            self._known, self._tries = True, 0
        if heard or self._asked:
            in_doubt = now_ns < self._in_doubt_until_ns
            self._silent_ns = now_ns + (self._follows_ns if in_doubt else self._patience_ns)
        self._heard = self._asked = False
        return heard

    def silent(self, now_ns: int) -> bool:
        """Whether it is not connected, or has heard nothing for longer than its patience."""
        return self.address is None or now_ns >= self._silent_ns

    def give_up(self) -> None:
        """Have no more patience with the present connection."""
        self._silent_ns = 0

    def take_answers(self, answered: Sequence[sockets.Socket]) -> None:
        """A host has answered these sockets' requests to connect."""
        self.answered = self.answered or any(socket in answered for socket in self.sockets)

    def connect(self, address: str, now_ns: int, hurried: bool = True) -> None:
        """Connect to `address` instead of the one before; the two may be the same.

        hurried: repeat the request soon, where that may be.
        """
        if self._known:
            hurried = hurried and self._tries % (HURRIED_TRIES + 1) < HURRIED_TRIES
        else:
            hurried = hurried and self._hurried
        self._tries += 1
        self.asked_ns, self.answered = now_ns, False
        for socket in self.sockets:
            sockets.reconnect(socket, self.address, address, self.answer_ns if hurried else 0)
        self.address = address
        self._silent_ns = now_ns + self._patience_ns


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
            time.sleep(LOOK_UP_AGAIN_S)
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
