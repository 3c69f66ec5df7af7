"""Why a sensing node is not reached, on real sockets of this machine, in virtual time."""

import errno
import os
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from display_node.reception.reachability import (
    AGAIN_NS,
    CONTROL_KINDS,
    FIRST_NS,
    FLICKER_NS,
    SILENT_NS,
    Reachability,
)
from tests.support.waiting import until

S = 1_000_000_000
HERE = "tcp://wrist.example:5555"


@pytest.fixture
def port() -> Iterator[int]:
    """A port at which nobody listens, and that no other program takes."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        yield taken.getsockname()[1]


def poll(
    reach: Reachability,
    now_ns: int,
    place: str | None,
    attempts: int = 0,
    established: bool = False,
) -> None:
    reach.poll(now_ns, place, established, established, attempts)


def refused(reach: Reachability, place: str, begin_ns: int = 0, attempts: int = 0) -> str:
    """Return the reason after a probe of `place` that fails, and twelve attempts of ZeroMQ."""
    poll(reach, begin_ns, place, attempts)
    poll(reach, begin_ns + FIRST_NS, place, attempts + 5)

    def reason() -> str:
        poll(reach, begin_ns + FIRST_NS, place, attempts + 12)
        return reach.reason().text

    until(lambda: "connecting" not in reason())
    return reason()


def test_at_a_port_without_a_listener_the_attempts_of_this_wait_are_counted(port: int) -> None:
    text = f"nobody listens at {HERE}, refused 12 times"
    reach = Reachability(HERE)
    assert reach.reason().text == f"connecting to {HERE}"
    assert refused(reach, f"tcp://127.0.0.1:{port}") == text
    again = Reachability(HERE)
    poll(again, 0, None, 100, established=True)
    assert refused(again, f"tcp://127.0.0.1:{port}", 60 * S, 100) == text


def test_a_file_that_is_not_there_has_no_listener(tmp_path: Path) -> None:
    reach = Reachability("ipc://pulse")
    text = "nobody listens at ipc://pulse, refused 12 times"
    assert refused(reach, f"ipc://{tmp_path}/pulse") == text


def test_a_host_that_does_not_answer_is_named_after_some_seconds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reach = Reachability(HERE)
    # As a host whose firewall drops the request.
    monkeypatch.setattr(
        "display_node.reception.reachability.ConnectionRequest.result", lambda probe: None
    )
    place = "tcp://127.0.0.1:9"
    for now_ns in (0, FIRST_NS, FIRST_NS + SILENT_NS - 1):
        poll(reach, now_ns, place, 3)
        assert reach.reason().text == f"connecting to {HERE}"
    poll(reach, FIRST_NS + SILENT_NS, place, 3)
    assert reach.reason().text == f"no answer from {HERE}"
    reach.close()


@pytest.mark.parametrize("error", ["ENETUNREACH", "EHOSTUNREACH"])
def test_a_network_without_a_route_is_named(error: str, monkeypatch: pytest.MonkeyPatch) -> None:
    number = getattr(errno, error)
    monkeypatch.setattr(
        "display_node.reception.reachability.ConnectionRequest.result", lambda probe: number
    )
    reach = Reachability(HERE)
    for now_ns in (0, FIRST_NS, FIRST_NS + 1):
        poll(reach, now_ns, "tcp://127.0.0.1:9", 3)
    assert reach.reason().text == f"no route to {HERE}"


def test_an_address_that_cannot_be_asked_refuses_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "display_node.reception.reachability.ConnectionRequest.result", lambda probe: errno.EINVAL
    )
    reach = Reachability(HERE)
    for now_ns in (0, FIRST_NS, FIRST_NS + 1):
        poll(reach, now_ns, "tcp://127.0.0.1:9")
    assert reach.reason().text == f"cannot connect to {HERE}: {os.strerror(errno.EINVAL)}"


def test_a_connection_that_is_made_anew_is_up_meanwhile() -> None:
    reach = Reachability(HERE)
    poll(reach, 0, None, established=True)
    poll(reach, FLICKER_NS - 1, None)
    assert reach.is_up(FLICKER_NS - 1)
    assert not reach.is_up(FLICKER_NS)


ZEROMQ = b"\xff" + 7 * b"\0" + b"\x01\x7f\x03\x01%b" + 32 * b"\0"
NULL, CURVE = ZEROMQ % b"NULL".ljust(20, b"\0"), ZEROMQ % b"CURVE".ljust(20, b"\0")


def ready(kind: bytes) -> bytes:
    """Return the greeting and the first command of a ZeroMQ socket without security."""
    return NULL + b"\x04\x20\x05READY\x0bSocket-Type" + struct.pack(">I", len(kind)) + kind


NO_NODE = f"{HERE} answers, but is no node:"
OTHER_KIND = f"{HERE} speaks ZeroMQ, but serves no data"


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (b"SSH-2.0-OpenSSH_9.2\r\n", f"{NO_NODE} it sends 'SSH-2.0-OpenSSH_9.2'"),
        (b"HTTP/1.1 400 \x1b[2J{}\r\n", rf"{NO_NODE} it sends 'HTTP/1.1 400 \x1b[2J{{}}'"),
        (b"", f"{HERE} breaks off as soon as it is connected"),
        (None, f"{HERE} accepts connections, but does not answer"),
        (ready(b"XPUB"), f"connecting to {HERE}"),
        (ready(b"ROUTER"), OTHER_KIND),
        (ready(b"REP"), OTHER_KIND),
        # It is encrypted, so what it is shows by its not being connected until the next probe.
        (CURVE, f"connecting to {HERE}"),
    ],
)  # fmt: skip
def test_what_answers_is_known_by_its_answer(answer: bytes | None, text: str) -> None:
    """A program that has said nothing is not named as no node."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        place, reach = f"tcp://127.0.0.1:{server.getsockname()[1]}", Reachability(HERE)
        for round_ns in (0, AGAIN_NS):
            poll(reach, round_ns, place)
            poll(reach, round_ns + FIRST_NS, place)
            with server.accept()[0] as program:
                if answer is not None:
                    poll(reach, round_ns + FIRST_NS, place)
                    assert program.recv(100).startswith(b"\xff")
                    program.sendall(answer)
                    program.close()
                poll_until_read(reach, round_ns + FIRST_NS, place, is_silent=answer is None)
            again = round_ns and answer is CURVE
            assert reach.reason().text == (OTHER_KIND if again else text)


def poll_until_read(reach: Reachability, now_ns: int, place: str, is_silent: bool) -> None:
    """Poll until the probe is read, or the time for an answer is over."""

    def is_read() -> bool:
        poll(reach, now_ns + is_silent * SILENT_NS, place)
        return reach._probe is None

    until(is_read)


def test_a_control_port_is_one_of_its_own_kind() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        place = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        reach = Reachability(HERE, CONTROL_KINDS)
        poll(reach, 0, place)
        poll(reach, FIRST_NS, place)
        with server.accept()[0] as program:
            program.sendall(ready(b"ROUTER"))
            poll_until_read(reach, FIRST_NS, place, is_silent=False)
        assert reach.found is None


def test_a_listener_is_probed_seldom() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5)
        reach = Reachability(HERE)
        place = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        for now_ns in range(0, FIRST_NS + AGAIN_NS, S // 100):
            poll(reach, now_ns, place)
        server.accept()[0].close()
        server.settimeout(0.1)
        with pytest.raises(TimeoutError):
            server.accept()
