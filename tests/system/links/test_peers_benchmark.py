from collections.abc import Iterator

import pytest
import zmq

from benchmarks.peers import BARE, LSL, OURS, OURS_CURVE, PEERS, Peer, row, run_in_turns, verdict
from benchmarks.peers.curve import join, make_keys, serve
from benchmarks.peers.message import Arrival
from benchmarks.peers.race import WARM_UP, Run, measure, run
from protocol.sockets import Context

MESSAGES = 50


def arrivals(*numbers: int) -> Iterator[Arrival]:
    """A warm-up that ends with number −1, and then messages of these numbers, 1 µs late."""
    for number in (*range(-WARM_UP, 0), *numbers):
        yield Arrival(number, number, number + 1_000)


def test_gaps_are_lost_and_what_comes_after_a_later_one_is_disordered() -> None:
    found = measure(arrivals(0, 1, 4, 3, 5), 5)
    assert (found.lost, found.disordered) == (2, 1)
    assert found.delays_ns.tolist() == [1_000] * 5
    assert found.cpu_ns > 0


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_messages_of_every_peer_come_across(peer: Peer) -> None:
    if peer.versions is None:
        pytest.skip(f"{peer.packages} are not installed")
    found = run(peer.module, peer.curve, MESSAGES)
    assert len(found.delays_ns) == MESSAGES
    assert found.delays_ns.min() > 0
    assert found.disordered == 0


def test_a_peer_whose_process_fails_is_an_error() -> None:
    with pytest.raises(RuntimeError, match="no_such_peer: its subscriber ended"):
        run("no_such_peer", curve=False, messages=1)


def made(p50_us: int) -> Run:
    return measure(iter([Arrival(n, 0, p50_us * 1_000) for n in range(WARM_UP + 3)]), 3)


def test_ratios_are_taken_round_by_round() -> None:
    runs = {OURS: [made(10), made(300), made(10)], BARE: [made(10), made(100), made(20)]}
    assert row(OURS, runs)[-2:] == ("1.00", "")
    assert "1.00 times that of pyzmq; the bar is 1.25: met" in verdict(OURS, BARE, 1.25, runs)
    assert verdict(BARE, OURS, 0.9, runs).endswith("missed")
    assert "cannot be compared with" in verdict(OURS, LSL, 1.0, runs)


def test_a_missing_package_is_a_row_that_says_so() -> None:
    absent = Peer("absent", "absent", ("no-such-package",))
    runs = run_in_turns((absent,), rounds=1, messages=1)
    assert row(absent, runs) == ("absent", "not installed")


@pytest.mark.parametrize("peer", [OURS, OURS_CURVE], ids=lambda peer: peer.name)
def test_curve_is_on_where_it_is_asked_for(context: Context, peer: Peer) -> None:
    keys = make_keys() if peer.curve else None
    ends = serve(context.socket(zmq.PUB), keys), join(context.socket(zmq.SUB), keys)
    wanted = zmq.SecurityMechanism.CURVE if peer.curve else zmq.SecurityMechanism.NULL
    assert [end.getsockopt(zmq.MECHANISM) for end in ends] == [wanted, wanted]


def test_a_display_without_keys_gets_nothing_from_a_publisher_with_them(context: Context) -> None:
    publisher = serve(context.socket(zmq.PUB), make_keys())
    port = publisher.bind_to_random_port("tcp://127.0.0.1")
    stranger = context.socket(zmq.SUB)
    stranger.subscribe(b"")
    monitor = stranger.get_monitor_socket(
        zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_DISCONNECTED
    )
    stranger.connect(f"tcp://127.0.0.1:{port}")
    assert monitor.poll(20_000)
