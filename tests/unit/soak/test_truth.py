"""The record of what was felt, and each check of statements against it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from display_node.scoring.availability import InterruptionCounter
from protocol.faults import Fault, FaultKind, Note, Part
from protocol.finger import FingerState
from protocol.summary.fields import Availability, Loop, SampleCounts, Summary
from protocol.wire.telemetry import Trace
from soak.claims import StatusClaim, no_figures
from soak.felt import FeltLog, felt_again_ns, longest_gap_ns
from soak.truth import judge_events, judge_statuses

MS = 1_000_000


def trace(
    from_ms: int, count: int, felt_n: float | list[float] = 0.245, full: bool = True
) -> Trace:
    now_ns = (from_ms + np.arange(count)) * MS
    felt, target = np.full(count, felt_n), np.zeros(count)
    return Trace(now_ns, now_ns, target, felt, np.full(count, full))


def record(*traces: Trace) -> FeltLog:
    found = FeltLog(MS)
    for each in traces:
        found.add_trace(each)
    return found


def test_spells_interruptions_and_misses_are_kept_apart_by_process() -> None:
    felt = record(trace(0, 20), trace(20, 20, full=False), trace(90, 20))
    assert felt.spells == [(0, 19 * MS), (90 * MS, 109 * MS)]
    assert felt.interruptions == [(19 * MS, 90 * MS, 20)]
    assert felt.misses == [(39 * MS, 90 * MS, 50)]
    assert felt.gaps == [(39 * MS, 90 * MS, True)]
    felt.begin_process()
    felt.add_trace(trace(900, 20))
    assert len(felt.interruptions) == len(felt.misses) == len(felt.gaps) == 1
    assert (felt.ticks, felt.full, felt.last) == (80, 60, (919 * MS, 0.245, True))
    assert felt.newest_ns(500 * MS) == 109 * MS
    assert felt.between(300 * MS, 800 * MS).low_n is None
    assert record().spells == record().misses == record().interruptions == []


def test_felt_again_is_felt_for_good_and_gaps_count_at_both_ends() -> None:
    spells = [(0, 1_000 * MS), (1_900 * MS, 1_950 * MS), (2_500 * MS, 9_000 * MS)]
    assert felt_again_ns(spells, 1_100 * MS, 9_000 * MS) == 1_400 * MS
    assert felt_again_ns(spells, 500 * MS, 9_000 * MS) == 0
    assert felt_again_ns(spells, 1_100 * MS, 2_400 * MS) is None
    # The rest of a touch at the end of the fault is not long enough.
    assert felt_again_ns(spells, 900 * MS, 9_000 * MS) == 1_600 * MS
    for from_ms, until_ms, gap_ms in ((0, 9_000, 900), (3_000, 8_000, 0), (8_000, 9_700, 700)):
        assert longest_gap_ns(spells, from_ms * MS, until_ms * MS) == gap_ms * MS
    assert longest_gap_ns([], 100 * MS, 400 * MS) == 300 * MS


OVERRUN = Fault(FaultKind.OVERRUN, Part.LOOP, "loop overrun")


def summary(**changes: Any) -> dict[str, Any]:
    whole = Summary(
        samples=SampleCounts(100, 90, 7, 2, 1, 0),
        availability=Availability(10.0, 0.9, 0, 0.1, 0, 0, 0, 0, 0.9, 0.9),
        loop=Loop(10_000, 0),
        finger=FingerState(0.245, measured_by="model, no drive"),
    )
    return replace(whole, **changes).to_dict()


def claim(state: str = "playing", at_ms: int = 0, full: bool = True, **changes: Any) -> StatusClaim:
    at_ns, whole = at_ms * MS, summary(**changes)
    return StatusClaim(at_ns, at_ns, 0.2452, full, 0, 0, state, False, whole)


def verdicts(*claims: StatusClaim) -> dict[str, bool | None]:
    """Return the verdicts on state, finger, figures and availability."""
    return {x.name.split()[0]: x.ok for x in judge_statuses("restarted", [claims], MS)}


@pytest.mark.parametrize(
    ("status", "failed"),
    [
        (claim(), ""),
        (claim("stale", full=False), ""),
        (claim("fault", full=False, faults=[OVERRUN]), ""),
        (claim(notes=[Note(Part.SENSOR, "3 readings missed")]), ""),
        (replace(claim("waiting"), final=True), ""),
        (claim("playing", full=False), "state"),
        (claim("stale", full=True), "state"),
        (claim("stale", full=False, faults=[OVERRUN]), "state"),
        (claim("fault", full=False), "state"),
        (claim(finger=FingerState(0.247)), "finger"),
        (claim(finger=FingerState(0.0)), "finger"),
        (claim(finger=FingerState()), "finger"),
        (claim(samples=SampleCounts(100, 90, 7, 2, 2, 0)), "figures"),
        (
            replace(claim(), no_figures=tuple(no_figures({"a": [1, {"b": float("nan")}]}))),
            "figures",
        ),
        (claim(within_jnd=1.2), "figures"),
        (claim(availability=Availability(10.0, 1.1, 0, 0, 0, 0, 0, 0, 1, 1)), "figures"),
        # More was judged than felt: the share would be printed for time without a pulse.
        (claim(availability=Availability(10.0, 0.1, 0, 0.9, 0, 0, 0, 0, 0.1, 0.9)), "figures"),
    ],
)
def test_a_status(status: StatusClaim, failed: str) -> None:
    assert [name for name, ok in verdicts(status).items() if ok is False] == failed.split()


def counting(*interruptions_ms: tuple[int, int]) -> list[StatusClaim]:
    """Return statuses every 0.2 s until 1.6 s of a display that counts these interruptions."""
    claims, counter = [], InterruptionCounter(1e-3)
    for ms in range(1_601):
        full = not any(begin < ms < end for begin, end in interruptions_ms)
        counter.add(np.array([full]), np.array([1]))
        if ms % 200 == 0:
            changes = {"loop": Loop(ms, 0), "interruptions": counter.interruptions()}
            claims.append(replace(claim(at_ms=ms, **changes), ticks=ms))
    return claims


@pytest.mark.parametrize(
    ("named_ms", "recorded_ms", "ok"),
    [
        ([(250, 1_000)], [(250, 1_000)], True),
        # Two between the same statuses.
        ([(210, 240), (250, 390)], [(210, 240), (250, 390)], True),
        ([], [(250, 1_000)], False),
        ([], [(250, 280)], False),
        ([(250, 1_000)], [], False),
        ([(250, 900)], [(250, 1_000)], False),
        ([(250, 300), (310, 990)], [(250, 1_000)], False),
    ],
)
def test_an_interruption_is_named_once(
    named_ms: list[tuple[int, int]], recorded_ms: list[tuple[int, int]], ok: bool
) -> None:
    recorded = [(a * MS, b * MS, b - a) for a, b in recorded_ms]
    assert judge_events("restarted", [counting(*named_ms)], recorded).ok is ok
