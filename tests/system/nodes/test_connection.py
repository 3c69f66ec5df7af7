import socket as plain
import threading
import time

import pytest
import zmq

from display_node.reception.addresses import Lookup
from display_node.reception.connection import Connection
from protocol.security.handshakes import HandshakeMonitor
from protocol.sockets import Context, Socket, control_address
from protocol.wire.messages import ClockRequest, SetPoint
from telepulse.processes import free_addresses
from tests.support.nodes import free_address
from tests.support.waiting import until

MS = 1_000_000
PATIENCE_S = 10.0


def here(port: str) -> tuple[object, ...]:
    """Return an entry of `getaddrinfo` for this machine."""
    return plain.AF_INET, plain.SOCK_STREAM, 6, "", ("127.0.0.1", int(port))


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Resolve every name to this machine; collect the names."""
    names: list[str] = []

    def look_up(host: str, port: str, **_: object) -> list[tuple[object, ...]]:
        names.append(host)
        return [here(port)]

    monkeypatch.setattr(plain, "getaddrinfo", look_up)
    return names


@pytest.fixture
def no_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hide the answers of hosts, which come in real time and not in the tests'."""
    monkeypatch.setattr(HandshakeMonitor, "poll", lambda self, now_ns: [])


def looked_up(lookup: Lookup) -> str | None:
    lookup.start()
    until(lambda: not lookup.running)
    return lookup.take()


def control_of(connection: Connection) -> Socket:
    return connection.control.socket


def poll_until_connected(connection: Connection, monitor: Socket) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not monitor.poll(5):
        assert time.monotonic() < end_s
        connection.poll(time.perf_counter_ns())


def poll(connection: Connection, from_ms: int, to_ms: int) -> list[int]:
    """Poll in virtual time; return the times in ms at which control was connected."""
    connected_ms = []
    for ms in range(from_ms, to_ms, 10):
        if connection.poll(ms * MS):
            connected_ms.append(ms)
        while any(route.lookup.running for route in connection.routes):
            threading.Event().wait(0.0005)
    return connected_ms


def answer_clock(server: Socket, peer: bytes, connection: Connection) -> None:
    """Let control receive a message."""
    server.send_multipart([peer, b"clock"])
    assert control_of(connection).poll(PATIENCE_S * 1000)
    assert list(connection.control.messages()) == [b"clock"]


def test_a_slow_name_server_does_not_block_the_loop(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer, asked = threading.Event(), []

    def slow(host: str, port: str, **_: object) -> list[tuple[object, ...]]:
        asked.append(host)
        assert answer.wait(PATIENCE_S)
        return [here(port)]

    monkeypatch.setattr(plain, "getaddrinfo", slow)
    connection = Connection(context, ["tcp://somewhere:5555"], 2)
    monitor = control_of(connection).get_monitor_socket(zmq.EVENT_CONNECT_DELAYED)
    for ms in range(0, 60_000, 10):
        connection.poll(ms * MS)
    assert asked == ["somewhere"]
    assert not monitor.poll(0)
    answer.set()
    poll_until_connected(connection, monitor)
    assert asked == ["somewhere"]
    connection.close()


def turning(context: Context, turns: int) -> tuple[Connection, Socket]:
    """Return a connection with further control connections that are established, and the peer."""
    address = free_address()
    server = context.socket(zmq.ROUTER)
    server.bind(control_address(address))
    connection = Connection(context, [address], 1, turns=turns)
    connection.subscribe(5 * MS, 0, 0)

    def connected() -> bool:
        connection.poll(time.perf_counter_ns())
        return len(connection.established) == turns + 1

    until(connected)
    return connection, server


def test_set_points_take_turns_over_further_connections_and_clock_requests_follow_them(
    context: Context,
) -> None:
    connection, server = turning(context, 3)
    now_ns = time.perf_counter_ns()
    point = SetPoint(7, 5, 0, 0, 1, 1.0)
    # Before a set-point has opened them, the further ones would be taken for other displays.
    control = connection.control.socket
    assert {connection.control_for(ClockRequest(1), now_ns) for _ in range(8)} == {control}
    senders = []
    for _ in range(6):
        connection.control_for(point, now_ns).send(b"point")
        assert server.poll(PATIENCE_S * 1000)
        peer, _ = server.recv_multipart()
        senders.append(peer)
        server.send_multipart([peer, b"report"])
    assert len(set(senders[:3])) == 3
    assert senders[:3] == senders[3:]
    read: list[bytes] = []
    until(lambda: read.extend(connection.control_messages()) or len(read) == 6)
    assert len({connection.control_for(ClockRequest(1), now_ns) for _ in range(16)}) == 4
    later_ns = now_ns + 10**10
    assert {connection.control_for(ClockRequest(1), later_ns) for _ in range(8)} == {control}


def test_control_moves_on_from_an_address_that_does_not_answer_and_stays_at_one_that_does(
    context: Context, asked: list[str], no_answers: None
) -> None:
    address, answering = free_addresses(2)
    server = context.socket(zmq.ROUTER)
    server.bind(control_address(answering))
    connection = Connection(context, [address, answering], 2)
    control = control_of(connection)
    assert poll(connection, 0, 1_000) == [10]
    assert poll(connection, 1_000, 3_000) == [2_010]
    control.send(b"clock?")
    assert server.poll(PATIENCE_S * 1000)
    peer, _ = server.recv_multipart()
    for ms in range(3_000, 10_000, 400):
        answer_clock(server, peer, connection)
        assert poll(connection, ms, ms + 400) == []
    # Once it is silent as well, it is tried once more, and then the first again.
    assert poll(connection, 10_200, 12_200) == [10_300]
    assert connection.control.address == control_address(answering)
    assert poll(connection, 12_200, 13_000) == [12_300]
    assert connection.control.address == control_address(address)


def test_the_ip_addresses_of_a_name_are_tried_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    def two(host: str, port: str, **_: object) -> list[tuple[object, ...]]:
        return [(plain.AF_INET6, plain.SOCK_STREAM, 6, "", ("::1", int(port), 0, 0)), here(port)]

    monkeypatch.setattr(plain, "getaddrinfo", two)
    lookup = Lookup("tcp://both:5555")
    found = [looked_up(lookup) for _ in range(3)]
    assert found == ["tcp://127.0.0.1:5555", "tcp://[::1]:5555", "tcp://127.0.0.1:5555"]
