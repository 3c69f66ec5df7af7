"""Strangers who connect and say nothing, on real sockets; the gate is tended by hand."""

import socket as plain
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
import zmq

from protocol import sockets
from protocol.security.authenticator import TOO_MANY, Authenticator
from protocol.security.budgets import BEHIND_NS
from protocol.security.connection_table import MAX_EVENTS, ConnectionTable
from protocol.sockets import Context, Socket
from tests.support.waiting import PATIENCE_S

MOST = 40
HERE, THERE = "127.0.0.1", "127.0.0.2"
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs 127.0.0.2 and filters")


class Guarded:
    """A bound PUB socket of few connections, and strangers that connect to it."""

    def __init__(self, context: Context, strangers: ExitStack) -> None:
        self.gate = Authenticator(context, None, most=MOST)
        self._context = context
        self._strangers = strangers
        self.data = sockets.bind(context, zmq.PUB, "tcp://*:*", self.gate)
        self.port = port_of(self.data)

    def stranger(self, whence: str) -> plain.socket:
        one = plain.create_connection((HERE, self.port), timeout=5, source_address=(whence, 0))
        return self._strangers.enter_context(one)

    def listener(self, whence: str) -> Socket:
        socket = sockets.unconnected(self._context, zmq.SUB)
        socket.subscribe(b"")
        socket.connect(f"tcp://{whence}:0;{HERE}:{self.port}")
        return socket

    def tend_until(self, done: Callable[[], object]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not done():
            assert time.monotonic() < end_s, self.gate.rejected
            self.gate.poll(time.monotonic_ns())
            sockets.send(self.data, b"frame")
            time.sleep(0.001)


@pytest.fixture
def guarded(context: Context) -> Iterator[Guarded]:
    with ExitStack() as strangers:
        yield Guarded(context, strangers)


def port_of(bound: Socket) -> int:
    return int(bound.getsockopt_string(zmq.LAST_ENDPOINT).rpartition(":")[2])


def is_closed(one: plain.socket) -> bool:
    one.setblocking(False)
    try:
        # ZeroMQ greets who connects; then nothing, or the end.
        while one.recv(100):
            pass
    except BlockingIOError:
        return False
    except ConnectionError:
        pass
    return True


def test_the_oldest_of_those_that_say_nothing_are_cut(guarded: Guarded, logged: list[str]) -> None:
    strangers = [guarded.stranger(HERE) for _ in range(2 * MOST)]
    cut = 2 * MOST - MOST // 2
    guarded.tend_until(lambda: guarded.gate.rejected[TOO_MANY] == cut)
    guarded.tend_until(lambda: sum(map(is_closed, strangers)) == cut)
    assert [is_closed(one) for one in strangers] == [True] * cut + [False] * (MOST // 2)
    assert len(logged) == 1
    assert logged[0].startswith(f"refused {HERE}: more connections than")


def test_strangers_keep_nobody_out_who_comes_from_elsewhere(guarded: Guarded) -> None:
    listener = guarded.listener(THERE)
    guarded.tend_until(lambda: listener.poll(0))
    for _ in range(2 * MOST):
        guarded.stranger(HERE)
    guarded.tend_until(lambda: guarded.gate.rejected[TOO_MANY])
    late = guarded.listener(THERE)
    guarded.tend_until(lambda: late.poll(0))
    while listener.poll(0):
        listener.recv()
    guarded.tend_until(lambda: listener.poll(0))


def test_strangers_at_one_door_keep_nobody_out_at_another(
    context: Context, guarded: Guarded
) -> None:
    """Nor from the same address: the oldest are cut, at whichever door."""
    later = sockets.bind(context, zmq.PUB, f"tcp://{HERE}:*", guarded.gate)
    port, guarded.port = guarded.port, port_of(later)
    for _ in range(2 * MOST):
        guarded.stranger(HERE)
    guarded.tend_until(lambda: guarded.gate.rejected[TOO_MANY])
    guarded.port = port
    listener = guarded.listener(HERE)
    guarded.tend_until(lambda: listener.poll(0))


def test_one_address_does_not_take_all_connections(guarded: Guarded) -> None:
    first = guarded.listener(THERE)
    listeners = [guarded.listener(HERE) for _ in range(MOST)]
    guarded.tend_until(lambda: guarded.gate.rejected[TOO_MANY] >= MOST - MOST * 3 // 4)
    late = guarded.listener(THERE)
    for one in (first, late):
        guarded.tend_until(lambda one=one: one.poll(0))
    for one in listeners:
        one.close(0)


def test_a_call_reads_little_however_much_has_happened(guarded: Guarded) -> None:
    for _ in range(5 * MAX_EVENTS):
        guarded.stranger(HERE).close()
    (door,) = guarded.gate._tables
    assert isinstance(door, ConnectionTable)
    guarded.tend_until(lambda: door.behind)
    assert door.connections <= MAX_EVENTS


def test_a_door_that_stays_behind_is_shut_until_all_is_read(guarded: Guarded) -> None:
    (door,) = guarded.gate._tables
    for _ in range(5 * MAX_EVENTS):
        guarded.stranger(HERE).close()
    guarded.tend_until(lambda: door.behind)
    guarded.gate.poll(time.monotonic_ns() + BEHIND_NS)
    assert door.behind
    late = plain.socket()
    late.settimeout(0.1)
    with late, pytest.raises(TimeoutError):
        late.connect((HERE, guarded.port))
    guarded.tend_until(lambda: not door.behind)
    guarded.stranger(HERE)
