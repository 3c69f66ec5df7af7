"""Real TCP of the kernel over the emulated link."""

import time

import pytest

from telepulse.simulation.link_scene import parse_link
from tests.support.netem import EmulatedLink, emulate
from tests.support.nodes import known
from tests.support.tcp import connected, needs_emulator

MS = 1_000_000


def round_trips_ms(link: EmulatedLink, count: int, number: int = 0) -> list[float]:
    """Return the durations of round trips over one of the links."""
    trips_ms = []
    with connected(link, number) as (sensing, display):
        for _ in range(count):
            began_ns = time.perf_counter_ns()
            display.sendall(b"?")
            sensing.sendall(sensing.recv(1))
            assert display.recv(1) == b"?"
            trips_ms.append((time.perf_counter_ns() - began_ns) / MS)
    return trips_ms


@pytest.mark.smoke
@needs_emulator
def test_a_round_trip_takes_the_time_of_the_model() -> None:
    with emulate(parse_link("delay=20ms")) as link:
        trips_ms = round_trips_ms(link, 20)
    # Never early; a busy machine adds to the least of 20 too. Twice the delay would be 80 ms.
    assert 40 <= min(trips_ms) < 80
    assert known(link.carried).lost == 0
    assert known(link.carried).packets >= 2 * 20
