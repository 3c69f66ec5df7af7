"""Proxy between two real nodes that delays or loses messages by a `MessageLink`."""

import heapq
import itertools
import math
import time
from collections.abc import Callable
from functools import partial

import zmq

from protocol import sockets
from protocol.errors import WireError
from protocol.security.authenticator import Authenticator
from protocol.security.budgets import SubscriptionBudget
from protocol.security.link_keys import ClientKeys, ServerKeys
from protocol.wire.messages import ProbeReport, SetPoint, decode_control
from telepulse.simulation.link_model import MessageLink
from telepulse.simulation.link_scene import LinkScene

IDLE_NS = 50_000_000
Arrival = Callable[[int, list[bytes]], int | None]
"""Returns the arrival of a message's parts that are sent now; None when it is lost."""


def _size(parts: list[bytes]) -> int:
    return sum(map(len, parts))


def _control_arrival_ns(link: MessageLink, now_ns: int, parts: list[bytes]) -> int | None:
    """Return the arrival of a control message; only set-points and their answers may be lost."""
    try:
        may_be_lost = isinstance(decode_control(parts[-1]), SetPoint | ProbeReport)
    except WireError:
        may_be_lost = False
    arrives = link.press_arrival_ns if may_be_lost else link.control_arrival_ns
    return arrives(now_ns, _size(parts))


class LinkProxy:
    """Proxy between a sensing node at `connect` and displays that connect to `bind`.

    client_keys: keys towards the sensing node. server_keys: keys towards displays, with the
    allow-list.

    Raises AddressError.
    """

    def __init__(
        self,
        scene: LinkScene,
        connect: str,
        bind: str,
        seed: int,
        client_keys: ClientKeys | None = None,
        server_keys: ServerKeys | None = None,
    ) -> None:
        now_ns = time.perf_counter_ns()
        down, up = (MessageLink(scene, seed + i, now_ns) for i in (0, 1))
        self._stopping = False
        self._waiting: list[tuple[int, int, sockets.Socket, list[bytes]]] = []
        self._order = itertools.count()
        context: sockets.Context = zmq.Context()
        self._context = context
        control_in, control_out = (sockets.control_address(a) for a in (connect, bind))
        data = sockets.connect(context, zmq.SUB, connect, client_keys)
        data.subscribe(b"")
        answers = sockets.connect(context, zmq.DEALER, control_in, client_keys)
        self._authenticator = Authenticator(context, server_keys)
        displays = sockets.bind(context, zmq.XPUB, bind, self._authenticator)
        self._subscribers = SubscriptionBudget(displays, (b"",))
        requests = sockets.bind(context, zmq.ROUTER, control_out, self._authenticator)
        # By receiving socket: the socket that its messages go to, and their arrival by the model.
        self._paths: dict[sockets.Socket, tuple[sockets.Socket, Arrival]] = {
            data: (displays, lambda now_ns, parts: down.data_arrival_ns(now_ns, _size(parts))),
            answers: (requests, partial(_control_arrival_ns, down)),
            requests: (answers, partial(_control_arrival_ns, up)),
        }

    def stop(self) -> None:
        """Make `run` return after the present message."""
        self._stopping = True

    def run(self, seconds: float | None = None) -> None:
        """Pass messages on until stopped, or for `seconds`."""
        end_ns = math.inf if seconds is None else time.perf_counter_ns() + seconds * 1e9
        readable = [*self._paths, *self._authenticator.own_sockets]
        try:
            while not self._stopping and (now_ns := time.perf_counter_ns()) < end_ns:
                self._authenticator.poll(now_ns)
                self._receive()
                sockets.wait_readable(readable, self._deliver())
        finally:
            self._context.destroy(linger=sockets.LINGER_MS)

    def _receive(self) -> None:
        self._subscribers.poll()
        for source, (onto, arrival_ns) in self._paths.items():
            for parts in sockets.receive_multipart(source):
                due_ns = arrival_ns(time.perf_counter_ns(), parts)
                if due_ns is not None:
                    heapq.heappush(self._waiting, (due_ns, next(self._order), onto, parts))

    def _deliver(self) -> int:
        """Send the due messages; return the time in ns until the next one."""
        while self._waiting:
            wait_ns = self._waiting[0][0] - time.perf_counter_ns()
            if wait_ns > 0:
                return min(wait_ns, IDLE_NS)
            _, _, socket, parts = heapq.heappop(self._waiting)
            sockets.send(socket, *parts)
        return IDLE_NS
