"""What the host's supervision claims, and does, under any sequence of events that the search finds.

Each invariant has a test that breaks the product once, and sees it found.
"""

import random
from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pulse_drives.axis import Axis
from pulse_drives.cia402.drive import Cia402Drive
from pulse_drives.supervisor import Supervisor
from pulse_drives.withdrawal import Withdrawal, WithdrawalOutcome
from tests.support.supervised_drive import (
    FAULTS,
    FILMS,
    KINDS,
    LINES,
    PRESS,
    SPEEDS_M_PER_S,
    STALLS_MS,
    STARTS_MS,
    TROUBLES,
    Event,
    InvariantError,
    events_of,
    finding,
    play,
    random_events,
    shrunk,
)

# Modelled time for each kind of drive and block of seeds: in `make test`, in `make test-all`.
QUICK_MS, ALL_MS = 10_000, 150_000
BLOCKS, SEEDS_PER_BLOCK = 4, 10_000
QUICK_EXAMPLES, ALL_EXAMPLES = 5, 20
BYTE = st.integers(0, 255)

SLOWLY = Event("speed", 0, SPEEDS_M_PER_S.index(5e-3))
REST = Event("speed", 0, 0)


def after(ms: int, name: str, choice: int = 0) -> Event:
    return Event(name, ms, choice)


def lasting(choice: int, stall_ms: int) -> int:
    """Return the value of an event that is chosen among four, and lasts so long."""
    return choice + 4 * STALLS_MS.index(stall_ms)


@pytest.mark.parametrize("block", range(BLOCKS))
@pytest.mark.parametrize("kind", KINDS)
def test_no_random_events_break_an_invariant(
    kind: str, block: int, request: pytest.FixtureRequest
) -> None:
    wanted_ms = QUICK_MS if request.config.getoption("quick") else ALL_MS
    passed_ms, seed = 0, block * SEEDS_PER_BLOCK
    while passed_ms < wanted_ms:
        events = random_events(random.Random(seed))
        try:
            passed_ms += play(kind, events).now_ms - STARTS_MS
        except InvariantError as error:
            pytest.fail(f"seed {seed}: {error}\n{shrunk(kind, events)}")
        seed += 1


@pytest.mark.parametrize("kind", KINDS)
def test_no_events_that_hypothesis_finds_break_an_invariant(
    kind: str, request: pytest.FixtureRequest
) -> None:
    examples = QUICK_EXAMPLES if request.config.getoption("quick") else ALL_EXAMPLES

    @settings(max_examples=examples)
    @given(st.lists(st.tuples(BYTE, BYTE, BYTE), max_size=12))
    def search(numbers: list[tuple[int, int, int]]) -> None:
        play(kind, [PRESS, *events_of(numbers)])

    search()


FILM_FAULT = next(
    n for n, (kind, part) in enumerate(FAULTS) if (kind, part.value) == ("silent", "film")
)
FULL, TORN, DRIFTING = map(FILMS.index, ("full", "torn", "drifting"))
# What was found, by its fewest events.
FOUND: dict[str, list[Event]] = {
    "a film that is read again after the loop hung": [PRESS, after(25, "loop stall", 11)],
    "commands that are lost when a withdrawal begins": [
        PRESS,
        after(54, "line", lasting(LINES.index("cut"), 40)),
        after(11, "fault", FILM_FAULT),
    ],
    "a motor that is held for a second": [
        PRESS,
        after(39, "freeze", STALLS_MS.index(2)),
        after(87, "trouble", lasting(TROUBLES.index("block"), 1_000)),
    ],
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", FOUND)
def test_what_was_found_is_mended(name: str, kind: str) -> None:
    assert finding(kind, FOUND[name]) is None


def towards_the_finger(*_: Any) -> float:
    return 5e-3


def at_rest(*_: Any) -> float:
    return 0.0


def unbounded(_: Axis, speed_m_per_s: float, *__: Any) -> float:
    return min(max(speed_m_per_s, -20e-3), 20e-3)


def on_the_finger(*_: Any) -> float:
    return 0.5e-3


def latch_any(supervisor: Supervisor, fault: Any, film_trusted: bool = True) -> None:
    latch(supervisor, fault, film_trusted)
    supervisor.fault = fault


latch = Supervisor.fail


def beat_after_a_fault(drive: Any, now_ns: int) -> None:
    if drive._supervisor.fault is None:
        send(drive, now_ns)
    else:
        drive._node.send_heartbeat()


send = Cia402Drive._send


def fail(*_: Any) -> None:
    raise RuntimeError("no")


def stored(withdrawal: Any) -> WithdrawalOutcome:
    outcome: WithdrawalOutcome = withdrawal._outcome
    return outcome


def always_trusting(fail: Callable[..., None]) -> Callable[..., None]:
    return lambda supervisor, fault, film_trusted=True: fail(supervisor, fault)


END = after(100, "end")
# Invariant -> kind of drive, what is broken, and the events that show it.
BROKEN: dict[str, tuple[str, Callable[[], Any], list[Event]]] = {
    "beyond its travel": (
        "tmcl",
        lambda: patch.object(Axis, "bounded", unbounded),
        [PRESS, after(400, "latency")],
    ),
    "sent towards the finger": (
        "tmcl",
        lambda: patch.object(Withdrawal, "speed_m_per_s", towards_the_finger),
        [PRESS, END],
    ),
    "goes on towards the finger": (
        "cia402",
        lambda: patch.object(Cia402Drive, "_send", beat_after_a_fault),
        [PRESS, after(20, "end")],
    ),
    "is replaced by": (
        "cia402",
        lambda: patch.object(Supervisor, "fail", latch_any),
        [PRESS, END, after(5, "fault", FILM_FAULT)],
    ),
    "under way for too long": (
        "tmcl",
        lambda: patch.object(Withdrawal, "outcome", property(stored)),
        [
            PRESS,
            END,
            after(1, "line", lasting(LINES.index("cut"), 10_000)),
            after(2_500, "latency"),
        ],
    ),
    "is shown as under way for too long": (
        "cia402",
        lambda: patch("pulse_drives.supervisor.UNSENT_NS", 10**12),
        [PRESS, END, after(1, "drive stall", STALLS_MS.index(1_000)), after(900, "latency")],
    ),
    "not off the finger in time": (
        "tmcl",
        lambda: patch.object(Withdrawal, "speed_m_per_s", at_rest),
        [PRESS, END],
    ),
    "although the tip is on the finger": (
        "cia402",
        lambda: patch.object(Axis, "clear_of", on_the_finger),
        [PRESS, after(100, "film", TORN), after(5, "end")],
    ),
    "although the film reads a press": (
        "tmcl",
        lambda: patch.object(Withdrawal, "_film_is_known", lambda *_: False),
        [SLOWLY, after(100, "film", FULL), END],
    ),
    "a film that was found at fault stops": (
        "tmcl",
        lambda: patch.object(Supervisor, "fail", always_trusting(Supervisor.fail)),
        [PRESS, after(110, "fault", FILM_FAULT), after(20, "film", DRIFTING)],
    ),
    "away from the finger is stopped": (
        "cia402",
        lambda: patch.multiple("pulse_drives.withdrawal", WRONG_WAY_N=-10.0, IN_A_ROW=1),
        [PRESS, END],
    ),
    "has met error": (
        "tmcl",
        lambda: patch.object(Withdrawal, "add_position", fail),
        [PRESS, END],
    ),
}


@pytest.mark.parametrize("invariant", BROKEN)
def test_each_invariant_finds_a_product_that_breaks_it(invariant: str) -> None:
    kind, broken, events = BROKEN[invariant]
    assert finding(kind, events) is None
    with broken():
        assert invariant in str(finding(kind, events))


def test_what_fails_is_shown_by_its_fewest_events() -> None:
    kind, broken, events = BROKEN["not off the finger in time"]
    with broken():
        # The last one is what gives the tip time to press.
        last = after(30, "origin")
        assert shrunk(kind, [after(1, "film"), *events, last]) == [PRESS, last]
