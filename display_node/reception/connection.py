"""The display's connection to its sensing node: routes, paths, sockets, reconnection."""

import itertools
import logging
from collections.abc import Iterator, Sequence

import zmq

from display_node.reception.addresses import Lookup
from display_node.reception.endpoint import FLOODED_NS, Endpoint
from display_node.reception.failover import DataPath
from display_node.reception.reachability import CONTROL_KINDS, Reachability
from display_node.reception.timeouts import Timeouts, answer_timeout_ns
from display_node.reception.turns import ControlTurns
from protocol import sockets
from protocol.refusals import HANDSHAKE, Reason
from protocol.security.handshakes import ClientLink, HandshakeMonitor, Refusal
from protocol.security.link_keys import ClientKeys
from protocol.summary.fields import DataConnections, Reconnections
from protocol.wire.messages import ClockRequest, ControlMessage, SetPoint

logger = logging.getLogger(__name__)


class Route:
    """One address of the sensing node and the data paths that are connected to it.

    link: the present refusal of these. frames_first: number of frames whose first copy came over
    this address.
    """

    def __init__(
        self,
        context: sockets.Context,
        address: str,
        paths: int,
        keys: ClientKeys | None,
        handshakes: HandshakeMonitor,
    ) -> None:
        sockets.control_address(address)  # Raises AddressError.
        self.address = address
        self.paths = [DataPath(context, keys) for _ in range(paths)]
        endpoints = [endpoint for path in self.paths for endpoint in path.endpoints]
        self.link = handshakes.watch([each.socket for each in endpoints], lambda: address)
        self.lookup = Lookup(address)
        self.data_port = Reachability(address)
        self.control_port = Reachability(sockets.control_address(address), CONTROL_KINDS)
        self.frames_first = 0

    @property
    def control_address(self) -> str | None:
        """The control address, with an IP address as its host; None while that is not known."""
        data = self.paths[0].first.address
        return None if data is None else sockets.control_address(data)

    def messages(self) -> Iterator[bytes]:
        """Yield the messages that wait."""
        for path in self.paths:
            yield from path.messages()

    def poll(self, now_ns: int) -> None:
        """Look the host name up while a path needs it, and connect to the IP address found."""
        found = None if self.lookup.running else self.lookup.take()
        wanted = [path.poll(now_ns, found) for path in self.paths]
        if any(wanted) and found is None and not self.lookup.running:
            self.lookup.start()


def _port_name(address: str) -> str:
    return f"port {address.rpartition(':')[2]}" if address.startswith("tcp://") else address


# After a pause of this process of at least this time, the first messages may be queued ones, which
# do not show that the connection still works.
STALLED_NS = 250_000_000


class Connection:
    """Control and data sockets of one stream, over one address or several.

    A path is a data connection, with a second socket in reserve; paths are distributed over the
    addresses. Control uses one address at a time, and moves to the next when nothing is received.
    An endpoint is one socket, of control or of a path.

    paths: number of paths, at least one for each address. rejected: number of refused connections
    by cause, and of messages dropped in floods. Raises AddressError for an invalid address.
    """

    def __init__(
        self,
        context: sockets.Context,
        addresses: Sequence[str],
        paths: int,
        keys: ClientKeys | None = None,
        turns: int = 0,
    ) -> None:
        self._handshakes = HandshakeMonitor(context, keys)
        handshakes, count = self._handshakes, len(addresses)
        self.routes = [
            Route(context, address, len(range(number, paths, count)), keys, handshakes)
            for number, address in enumerate(addresses)
        ]
        self._turns = itertools.cycle(self.routes)
        # Of the stream; None before it is known.
        self._timeouts: Timeouts | None = None
        self._received_ns: int | None = None
        # Whether the sensing node was ever reached: before that, there is nothing to reconnect.
        self._reached = False
        self._polled_ns: int | None = None
        self._cut_ns = Timeouts().cut_ns
        self._controls = self._clock_requests = 0
        self.control = Endpoint(sockets.unconnected(context, zmq.DEALER, keys))
        self._further = ControlTurns(context, turns, keys)
        self._paths = [path for route in self.routes for path in route.paths]
        self._endpoints = [
            self.control,
            *(endpoint for path in self._paths for endpoint in path.endpoints),
        ]
        waited_for = [*self._endpoints, *self._further.endpoints]
        self.descriptors = sockets.descriptors(endpoint.socket for endpoint in waited_for)
        self._control_link = self._watch_control(self.control)
        for endpoint in self._further.endpoints:
            self._watch_control(endpoint)
        self.rejected = self._handshakes.rejected
        self.established = self._handshakes.established
        self._named: list[tuple[DataPath | Endpoint, str]] = [(self.control, "control")]
        self._named += [(endpoint, "control") for endpoint in self._further.endpoints]
        self._named += [(path, route.address) for route in self.routes for path in route.paths]
        # Names of the endpoints whose flood was reported, and reports of a blocked port.
        self._flooded: set[str] = set()
        self._named_blocks: set[str] = set()

    @property
    def reconnections(self) -> Reconnections:
        """Counts of connections opened beside silent ones, or in place of them."""
        opened = sum(path.failover.opened for path in self._paths)
        kept = sum(path.failover.kept for path in self._paths)
        return Reconnections(opened, kept, self._controls)

    @property
    def data_connections(self) -> DataConnections:
        """Number of paths."""
        return DataConnections(len(self._paths))

    def subscribe(self, frame_ns: int, round_trip_ns: int, now_ns: int) -> None:
        """Subscribe to frames; one frame covers `frame_ns`.

        round_trip_ns: time of a request to the sensing node and of its reply.
        """
        before, answer_ns = self._timeouts, answer_timeout_ns(round_trip_ns)
        if before is not None and (before.frame_ns, before.answer_ns) == (frame_ns, answer_ns):
            return
        self._timeouts = timeouts = Timeouts(frame_ns, answer_ns)
        self.control.answer_ns = timeouts.answer_ns
        for path in self._paths:
            path.set_timeouts(timeouts)
            if before is None:
                path.subscribe(now_ns)

    def poll(self, now_ns: int) -> bool:
        """Reconnect silent endpoints whose address is known; call each tick.

        Returns whether control has a new connection, over which the display must send a hello.
        """
        control = self.control
        if answered := self._handshakes.poll(now_ns):
            for endpoint in (*self._endpoints, *self._further.endpoints):
                if endpoint.socket in answered:
                    endpoint.answer(now_ns)
        self._close_floods(now_ns)
        cut = self._cut(now_ns)
        for path in self._paths if cut else ():
            path.failover.give_up()
        for route in self.routes:
            route.poll(now_ns)
            self._probe(route, now_ns)
        if self._timeouts is not None:
            known = [
                (route.address, control_address)
                for route in self.routes
                if (control_address := route.control_address) is not None
            ]
            self._further.poll(known, self._timeouts.answer_ns, now_ns)
        introduce = self._repeat_request(now_ns)
        if cut and control.address is not None:
            return self._connect_control(control.address, now_ns)
        return introduce or (control.silent(now_ns) and self._move_control(now_ns))

    def waiting_for(self, now_ns: int) -> list[Reason]:
        """Return what is waited for at each address, or why it does not come.

        The addresses that refuse this display come first, as the first of them has the cause in
        `refused`.
        """
        refusing_first = sorted(self.routes, key=lambda route: self._refusal(route) is None)
        return [self._reason(route, now_ns) for route in refusing_first]

    @property
    def refused(self) -> str | None:
        """Cause of the present refusal, of several addresses the first one's; None without any."""
        refusals = (self._refusal(route) for route in self.routes)
        return next((refusal.cause for refusal in refusals if refusal is not None), None)

    def close(self) -> None:
        """Withdraw what was requested beside ZeroMQ's sockets."""
        for route in self.routes:
            route.data_port.close()
            route.control_port.close()

    def _reason(self, route: Route, now_ns: int) -> Reason:
        data, control = route.data_port, route.control_port
        refusal, is_program = self._refusal(route), data.found is not None and data.found.is_program
        # What a program has sent says more than that it breaks off.
        if refusal is not None and not (refusal.cause == HANDSHAKE and is_program):
            return refusal.reason
        if (blocked := self._blocked(route, now_ns)) is not None:
            return blocked
        if data.is_up(now_ns):
            if self.control.given == route.address and not control.is_up(now_ns):
                return control.reason()
            return Reason(f"{route.address} is connected, but sends nothing")
        return Reason(route.lookup.failure) if route.lookup.failure else data.reason()

    def _blocked(self, route: Route, now_ns: int) -> Reason | None:
        """Return what is wrong with one of an address's two ports while the other is connected."""
        data, control = route.data_port, route.control_port
        if self.control.given != route.address or data.is_up(now_ns) == control.is_up(now_ns):
            return None
        ports = [
            f"data on {_port_name(route.address)}",
            f"control on {_port_name(control.address)}",
        ]
        found = control.found
        if control.is_up(now_ns):
            found = data.found
            ports.reverse()
        if found is None:
            return None
        text = f"{route.address}: {ports[0]} is connected, {ports[1]} {found.at_port}"
        further = "open or forward that port at the node, and in firewalls, routers and tunnels"
        return Reason(text, further)

    def has_data_link(self, now_ns: int) -> bool:
        """Return whether the data port of any address is connected."""
        return any(route.data_port.is_up(now_ns) for route in self.routes)

    def _refusal(self, route: Route) -> Refusal | None:
        """Return the present refusal of an address, by its data port or by its control port."""
        of_control = self._control_link.refusal
        if of_control is not None and of_control.address != route.address:
            of_control = None
        return route.link.refusal or of_control

    def _watch_control(self, endpoint: Endpoint) -> ClientLink:
        return self._handshakes.watch([endpoint.socket], lambda: endpoint.given)

    def _probe(self, route: Route, now_ns: int) -> None:
        handshakes, refusal = self._handshakes, self._refusal(route)
        # A refusal is the reason: a probe would find none, and count as a broken handshake.
        is_refused = refusal is not None and refusal.cause != HANDSHAKE
        ports = [(route.data_port, route.paths[0].first)]
        if self.control.given == route.address:
            ports.append((route.control_port, self.control))
        for port, endpoint in ports:
            link = endpoint.socket
            port.poll(
                now_ns,
                None if is_refused else endpoint.address,
                connected=link in handshakes.connected,
                established=link in self.established,
                attempts=handshakes.retried[link],
            )
        blocked = self._blocked(route, now_ns)
        if blocked is not None and str(blocked) not in self._named_blocks:
            self._named_blocks.add(str(blocked))
            logger.warning(str(blocked))

    def control_for(self, message: ControlMessage, now_ns: int) -> sockets.Socket:
        """Return the control connection for a message, which is sent now.

        Set-points go over the further ones in turns, clock requests also over control.
        """
        control, further = self.control.socket, None
        if isinstance(message, SetPoint):
            further = self._further.next(self.established, now_ns, set_point=True)
        elif isinstance(message, ClockRequest):
            self._clock_requests += 1
            if self._clock_requests % (len(self._further.endpoints) + 1):
                further = self._further.next(self.established, now_ns, set_point=False)
        return further or control

    def control_messages(self) -> Iterator[bytes]:
        """Yield the messages that wait on the control connections; call it each tick."""
        # Usually nothing waits, and an exception would take twice as long as this check.
        if sockets.has_message(self.control.socket):
            yield from self.control.messages()
        yield from self._further.messages()

    def _close_floods(self, now_ns: int) -> None:
        """Close the endpoints that receive more than any stream sends, for a few seconds."""
        for endpoint, name in self._named:
            if not endpoint.flooded(now_ns):
                continue
            self.rejected["flood"] += max(1, endpoint.close(now_ns + FLOODED_NS))
            if name not in self._flooded:
                self._flooded.add(name)
                logger.warning(
                    f"{name} sends far more than a stream; closed for {FLOODED_NS // 10**9} s"
                )

    def _repeat_request(self, now_ns: int) -> bool:
        """Repeat a connection request of control or data, if only the other's was answered.

        The request was lost while the network was cut; the kernel would repeat it late
        (decision 27). Return whether control has a new connection.
        """
        control = self.control
        for path in self._paths:
            data = path.first
            pending = control if data.answered else data
            if (
                control.answered == data.answered
                or now_ns - pending.asked_ns < pending.answer_ns
                or data.address is None
                or sockets.control_address(data.address) != control.address
            ):
                continue
            # A repetition may come too early for a slow network: only the kernel repeats this one,
            # and it waits for the other's answer time.
            pending.answer_ns = max(control.answer_ns, data.answer_ns)
            if pending is control:
                return self._connect_control(control.address, now_ns, fast_retry=False)
            data.connect(data.address, now_ns, fast_retry=False)
        return False

    def _cut(self, now_ns: int) -> bool:
        """Return True once in each silence of all endpoints that has lasted for too long."""
        polled_ns, self._polled_ns = self._polled_ns, now_ns
        stalled = polled_ns is not None and now_ns - polled_ns >= STALLED_NS
        for path in self._paths if stalled else ():
            path.failover.mark_suspect(now_ns)
        # `take_received` resets its count: one call for each path.
        received = sum(path.take_received(now_ns) for path in self._paths)
        if received + self.control.received(now_ns):
            self._received_ns, self._reached = now_ns, True
            timeouts = self._timeouts or Timeouts(0)
            if timeouts.answer_ns != self.control.answer_ns:
                timeouts = Timeouts(timeouts.frame_ns, self.control.answer_ns)
            self._cut_ns = timeouts.follows_ns if stalled else timeouts.cut_ns
        elif self._received_ns is not None and now_ns - self._received_ns >= self._cut_ns:
            # After its end a stream is silent, which is no cut.
            self._received_ns = None
            return True
        return False

    def _move_control(self, now_ns: int) -> bool:
        for route in itertools.islice(self._turns, len(self.routes)):
            address = route.control_address
            if address is not None:
                self.control.given = route.address
                return self._connect_control(address, now_ns)
        return False

    def _connect_control(self, address: str, now_ns: int, fast_retry: bool = True) -> bool:
        self._controls += self._reached
        self.control.connect(address, now_ns, fast_retry)
        return True
