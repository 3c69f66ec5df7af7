"""A proxy between two real nodes that delays or loses messages by a `MessageLink`.

Data frames can be lost, control messages only delayed.
"""

import heapq
import itertools
import time

import zmq

from protocol import sockets
from protocol.security.authenticator import Authenticator
from protocol.security.budgets import SubscriptionBudget
from protocol.security.keys import ClientKeys, ServerKeys
from telepulse.simulation.link_model import LinkScene, MessageLink

IDLE_NS = 50_000_000


class LinkProxy:
    """Proxy between a sensing node at `connect` and displays that connect to `bind`.

    client_keys: keys towards the sensing node. server_keys: keys towards displays, with the
    allow-list.

    Raises AddressError or KeyFileError.
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
        now_ns = time.monotonic_ns()
        self._down, self._up = (MessageLink(scene, seed + i, now_ns) for i in (0, 1))
        self._stopping = False
        self._waiting: list[tuple[int, int, sockets.Socket, list[bytes]]] = []
        self._order = itertools.count()
        self._context: sockets.Context = zmq.Context()
        context = self._context
        control_in, control_out = (sockets.control_address(a) for a in (connect, bind))
        self._data_in = sockets.connect(context, zmq.SUB, connect, client_keys)
        self._data_in.subscribe(b"")
        self._control_in = sockets.connect(context, zmq.DEALER, control_in, client_keys)
        self._authenticator = Authenticator(context, server_keys)
        self._data_out = sockets.bind(context, zmq.XPUB, bind, self._authenticator)
        self._subscribers = SubscriptionBudget(self._data_out, (b"",))
        self._control_out = sockets.bind(context, zmq.ROUTER, control_out, self._authenticator)

    def stop(self) -> None:
        """Make `run` return after the present message."""
        self._stopping = True

    def run(self) -> None:
        """Pass messages on until stopped."""
        inputs = (self._data_in, self._control_in, self._control_out)
        readable = [*inputs, *self._authenticator.sockets]
        try:
            while not self._stopping:
                self._authenticator.poll(time.monotonic_ns())
                self._receive()
                sockets.wait_readable(readable, self._deliver())
        finally:
            self._context.destroy(linger=sockets.LINGER_MS)

    def _receive(self) -> None:
        self._subscribers.poll()
        for from_, onto, arrival_ns in (
            (self._data_in, self._data_out, self._down.data_arrival_ns),
            (self._control_in, self._control_out, self._down.control_arrival_ns),
            (self._control_out, self._control_in, self._up.control_arrival_ns),
        ):
            for parts in sockets.receive_multipart(from_):
                due_ns = arrival_ns(time.monotonic_ns(), sum(map(len, parts)))
                if due_ns is not None:
                    heapq.heappush(self._waiting, (due_ns, next(self._order), onto, parts))

    def _deliver(self) -> int:
        """Send the due messages; return the time in ns until the next one."""
        while self._waiting:
            wait_ns = self._waiting[0][0] - time.monotonic_ns()
            if wait_ns > 0:
                return min(wait_ns, IDLE_NS)
            _, _, socket, parts = heapq.heappop(self._waiting)
            sockets.send(socket, *parts)
        return IDLE_NS
