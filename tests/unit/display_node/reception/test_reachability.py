"""Why a sensing node is not reached, on real sockets of this machine, in virtual time."""

import errno
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from display_node.reception.reachability import (
    AGAIN_NS,
    FIRST_NS,
    FLICKER_NS,
    NO_NODE_NS,
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


def refused(reach: Reachability, place: str, begin_ns: int = 0, attempts: int = 0) -> str:
    """Return the reason after a probe of `place` that fails, and twelve attempts of ZeroMQ."""
    reach.poll(begin_ns, place, False, attempts)
    reach.poll(begin_ns + FIRST_NS, place, False, attempts + 5)

    def reason() -> str:
        reach.poll(begin_ns + FIRST_NS, place, False, attempts + 12)
        return reach.reason(begin_ns + FIRST_NS).text

    until(lambda: "connecting" not in reason())
    return reason()


def test_at_a_port_without_a_listener_the_attempts_of_this_wait_are_counted(port: int) -> None:
    text = f"nobody listens at {HERE}, refused 12 times"
    reach = Reachability(HERE)
    assert reach.reason(0).text == f"connecting to {HERE}"
    assert refused(reach, f"tcp://127.0.0.1:{port}") == text
    again = Reachability(HERE)
    again.poll(0, None, True, 100)
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
        reach.poll(now_ns, place, False, 3)
        assert reach.reason(now_ns).text == f"connecting to {HERE}"
    reach.poll(FIRST_NS + SILENT_NS, place, False, 3)
    assert reach.reason(FIRST_NS + SILENT_NS).text == f"no answer from {HERE}"
    reach.close()


@pytest.mark.parametrize("error", ["ENETUNREACH", "EHOSTUNREACH"])
def test_a_network_without_a_route_is_named(error: str, monkeypatch: pytest.MonkeyPatch) -> None:
    number = getattr(errno, error)
    monkeypatch.setattr(
        "display_node.reception.reachability.ConnectionRequest.result", lambda probe: number
    )
    reach = Reachability(HERE)
    for now_ns in (0, FIRST_NS, FIRST_NS + 1):
        reach.poll(now_ns, "tcp://127.0.0.1:9", False, 3)
    assert reach.reason(FIRST_NS + 1).text == f"no route to {HERE}"


def test_a_name_that_is_not_found_is_the_reason() -> None:
    reach = Reachability(HERE)
    reach.poll(0, None, False, 0)
    assert reach.reason(S, unknown_host="it is not found").text == "it is not found"


def test_a_host_that_completes_no_handshake_is_no_node() -> None:
    reach = Reachability(HERE)
    reach.poll(0, None, True, 0)
    assert reach.reason(NO_NODE_NS - 1).text == f"connecting to {HERE}"
    # The connection is made anew meanwhile.
    reach.poll(FLICKER_NS - 1, None, False, 0)
    reach.poll(NO_NODE_NS, None, True, 0)
    assert reach.reason(NO_NODE_NS).text == f"{HERE} answers, but is no node"
    assert (
        reach.reason(NO_NODE_NS, established=True).text == f"{HERE} is connected, but sends nothing"
    )


def test_a_listener_is_probed_seldom() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5)
        reach = Reachability(HERE)
        place = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        for now_ns in range(0, FIRST_NS + AGAIN_NS, S // 100):
            reach.poll(now_ns, place, False, 0)
        server.accept()[0].close()
        server.settimeout(0.1)
        with pytest.raises(TimeoutError):
            server.accept()
