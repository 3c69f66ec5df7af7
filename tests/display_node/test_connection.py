import socket as plain
import threading
import time

import pytest
import zmq

from display_node.connection import Connection, Lookup
from protocol.errors import AddressError
from protocol.sockets import Context

from ..nodes import free_address

MS = 1_000_000
PATIENCE_S = 10.0


def tend_until_connected(connection: Connection, monitor: zmq.Socket) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not monitor.poll(5):
        assert time.monotonic() < end_s
        connection.tend(time.monotonic_ns(), silent=True)


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1"])
def test_names_and_numbers_are_connected_to(host: str, context: Context) -> None:
    address = free_address()
    server = context.socket(zmq.ROUTER)
    server.bind(f"tcp://127.0.0.1:{int(address.rsplit(':')[-1]) + 1}")
    connection = Connection(context, address.replace("127.0.0.1", host), 1, log=print)
    events = zmq.EVENT_HANDSHAKE_SUCCEEDED
    tend_until_connected(connection, connection.control.get_monitor_socket(events))
    connection.control.send(b"hello")
    assert server.poll(PATIENCE_S * 1000)
    assert server.recv_multipart()[1] == b"hello"


def test_a_name_server_that_does_not_answer_holds_nothing_up(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer, asked = threading.Event(), []

    def slow(host: str, port: str, **_: object) -> list[tuple[object, ...]]:
        asked.append(host)
        assert answer.wait(PATIENCE_S)
        return [(plain.AF_INET, plain.SOCK_STREAM, 6, "", ("127.0.0.1", int(port)))]

    monkeypatch.setattr(plain, "getaddrinfo", slow)
    connection = Connection(context, "tcp://somewhere:5555", 2, log=print)
    monitor = connection.control.get_monitor_socket(zmq.EVENT_CONNECT_DELAYED)
    for ms in range(0, 60_000, 10):
        connection.tend(ms * MS, silent=True)
    assert asked == ["somewhere"]
    assert not monitor.poll(0)
    answer.set()
    tend_until_connected(connection, monitor)
    assert asked == ["somewhere"]


def test_a_connection_that_is_heard_is_let_be_and_a_silent_one_is_made_anew(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def count(host: str, port: str, **_: object) -> list[tuple[object, ...]]:
        asked.append(host)
        return [(plain.AF_INET, plain.SOCK_STREAM, 6, "", ("127.0.0.1", int(port)))]

    monkeypatch.setattr(plain, "getaddrinfo", count)
    connection = Connection(context, "tcp://somewhere:1", 1, log=print)

    def tend(from_ms: int, to_ms: int, silent: bool) -> None:
        for ms in range(from_ms, to_ms, 10):
            connection.tend(ms * MS, silent)
            threading.Event().wait(0.0005)

    tend(0, 1_000, silent=True)
    assert len(asked) == 1
    tend(1_000, 60_000, silent=False)
    assert len(asked) == 1
    tend(60_000, 70_000, silent=True)
    assert 4 <= len(asked) <= 7


def test_a_name_nobody_knows_is_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(host: str, port: str, **_: object) -> list[tuple[object, ...]]:
        raise plain.gaierror(plain.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(plain, "getaddrinfo", unknown)
    monkeypatch.setattr(time, "sleep", lambda _: None)
    said: list[str] = []
    lookup = Lookup("tcp://nowhere:5555", said.append)
    for _ in range(3):
        lookup.start()
        while lookup.running:
            threading.Event().wait(0.001)
        assert lookup.take() is None
    assert said == ["nowhere is not found: Name or service not known; trying on"]


def test_the_numbers_of_a_name_are_tried_one_after_the_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def two(host: str, port: str, **_: object) -> list[tuple[object, ...]]:
        return [
            (plain.AF_INET6, plain.SOCK_STREAM, 6, "", ("::1", int(port), 0, 0)),
            (plain.AF_INET, plain.SOCK_STREAM, 6, "", ("127.0.0.1", int(port))),
        ]

    monkeypatch.setattr(plain, "getaddrinfo", two)
    lookup = Lookup("tcp://both:5555", print)
    found = []
    for _ in range(3):
        lookup.start()
        while lookup.running:
            threading.Event().wait(0.001)
        found.append(lookup.take())
    assert found == ["tcp://127.0.0.1:5555", "tcp://[::1]:5555", "tcp://127.0.0.1:5555"]


def test_a_wrong_address_is_refused_at_once(context: Context) -> None:
    with pytest.raises(AddressError):
        Connection(context, "somewhere:5555", 1, log=print)
