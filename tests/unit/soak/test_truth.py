"""The record of what was felt, and each check of statements against it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from protocol.summary.tables import Availability, Loop, SampleCounts, Summary
from protocol.ticks import InterruptionCounter
from protocol.wire.telemetry import Trace
from soak.claims import StatusClaim, no_figures, read_line
from soak.felt import Bounds, FeltLog, felt_again_ns, longest_gap_ns
from soak.truth import judge_ends, judge_events, judge_lines, judge_stalls, judge_statuses

MS = 1_000_000
WRIST_PER_MIN = 75.0


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


def test_slews_after_missed_ticks_are_apart_and_none_is_between_processes() -> None:
    felt = record(trace(0, 150, 0.0), trace(150, 50, 0.02))
    assert felt.bounds().felt_slew_n_per_s == pytest.approx(20.0)
    felt.add_trace(trace(203, 3, [0.5, float("nan"), 0.5]))
    felt.add_trace(trace(2_000, 1, -0.2))
    assert felt.bounds() == Bounds(
        204, (0.0, 0.0), (-0.2, 0.5), 0.0, pytest.approx(20.0), pytest.approx(0.48 / 0.004), 1
    )


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


def summary(**changes: Any) -> dict[str, Any]:
    whole = Summary(
        samples=SampleCounts(100, 90, 7, 2, 1, 0),
        availability=Availability(10.0, 0.9, 0, 0.1, 0, 0, 0, 0, 0.9, 0.9),
        loop=Loop(10_000, 0),
        finger="pressed with 245 mN (model, no drive)",
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
        (claim("fault", full=False, faults=["loop overrun"]), ""),
        (claim(faults=["sensing node: 3 readings missed"]), ""),
        (replace(claim("waiting"), final=True), ""),
        (claim("playing", full=False), "state"),
        (claim("stale", full=True), "state"),
        (claim("stale", full=False, faults=["loop overrun"]), "state"),
        (claim("fault", full=False), "state"),
        (claim(finger="pressed with 247 mN (model, no drive)"), "finger"),
        (claim(finger="not pressed (model, no drive)"), "finger"),
        (claim(finger=None), "finger"),
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


@pytest.mark.parametrize(
    ("seconds", "felt_s", "ran_s", "ok"),
    [
        (100.0, 50.0, 99.0, True),
        (100.0, 50.9, 99.0, True),
        # The cut is left out, as in "felt 100 %" of a run of which half was cut.
        (50.0, 50.0, 99.0, False),
        (100.0, 52.0, 99.0, False),
        (100.0, 48.0, 99.0, False),
    ],
)
def test_availability_is_by_ticks(seconds: float, felt_s: float, ran_s: float, ok: bool) -> None:
    """The last status is 100 s after the first, with 50 s recorded at full strength."""
    whole_s, ticks = 10.0 + seconds, round(ran_s * 1e3)
    shares = Availability(whole_s, (9.0 + felt_s) / whole_s, missed=(seconds - ran_s) / whole_s)
    last = claim(at_ms=100_000, availability=shares, loop=Loop(10_000 + ticks, 0))
    counted = replace(last, ticks=ticks, full_ticks=50_000)
    assert verdicts(claim(), counted)["availability"] is ok


def line(text: str, at_ms: int, seen: FeltLog, *impostors: tuple[int, int]) -> list[str]:
    """Return the names of the checks that a line of a terminal fails."""
    found = read_line(text, at_ms * MS)
    assert found is not None, text
    checks = judge_lines("restarted", [found], seen, WRIST_PER_MIN, impostors)
    return [check.name.partition(": ")[2] for check in checks if check.ok is False]


def shown(state: str, rate: str = "75", felt: str = "245", finger: str = "") -> str:
    """Return a line as a terminal shows it, with an item for each that is not empty."""
    items = [f"heart rate {rate} /min"] if rate else []
    items += [f"felt {felt} of 245 mN"] if felt else []
    items += [f"finger {finger} (model, no drive)"] if finger else []
    return f"{state}{', '.join(items)}; deadline misses"


FORCE, AGE, RATE = "state and force", "age", "heart rate"
PLAYING = record(*(trace(number * 20, 20) for number in range(500)))
AT_REST = record(*(trace(number * 20, 20, 0.0, full=False) for number in range(500)))
SILENT = "no telemetry: since 5 s; finger: unknown, before that: pressed with 245 mN; "


@pytest.mark.parametrize(
    ("text", "at_ms", "seen", "errors"),
    [
        (shown("playing: "), 10_100, PLAYING, []),
        (shown("stale: ", rate="", felt="", finger="not pressed"), 10_100, AT_REST, []),
        ("ended", 10_100, AT_REST, []),
        (shown("playing: "), 10_100, AT_REST, [FORCE, RATE]),
        (shown("stale: "), 10_100, PLAYING, [FORCE]),
        (shown("playing: ", finger="not pressed"), 10_100, PLAYING, [FORCE]),
        (shown("playing: ", finger="pressed with 372 mN"), 10_100, PLAYING, [FORCE]),
        (shown("playing: ", felt="339"), 10_100, PLAYING, [FORCE]),
        (shown("stale: no samples to play, ", rate="", felt="", finger="pressed with 245 mN"),
         10_100, AT_REST, [FORCE]),
        (shown("playing: ", rate="13"), 10_100, PLAYING, [RATE]),
        # The display ended or froze at 10 s.
        (shown("playing: "), 15_000, PLAYING, [FORCE, AGE, RATE]),
        (shown(f"playing 5.0 s ago: {SILENT}", rate="", felt=""), 15_000, PLAYING, []),
        (shown(f"playing 2.0 s ago: {SILENT}", rate="", felt=""), 15_000, PLAYING, [FORCE, AGE]),
        (shown("playing 5.0 s ago: ", rate="", felt=""), 15_000, PLAYING, [AGE]),
        (shown(f"playing 5.0 s ago: {SILENT}, ", rate="", finger="pressed with 245 mN"), 15_000,
         PLAYING, [AGE]),
        (shown(f"playing 5.0 s ago: {SILENT}"), 15_000, PLAYING, [AGE, RATE]),
        # It reports silence, but the display is not silent.
        (shown(f"playing 5.0 s ago: {SILENT}", rate="", felt=""), 9_900, PLAYING, [AGE]),
    ],
)  # fmt: skip
def test_a_line_of_a_terminal(text: str, at_ms: int, seen: FeltLog, errors: list[str]) -> None:
    assert line(text, at_ms, seen) == errors
    # A heart rate soon after an impostor's forces is not judged.
    judged = [error for error in errors if error != RATE]
    assert line(text, at_ms, seen, (at_ms * MS, at_ms * MS)) == judged


def counting(*interruptions_ms: tuple[int, int]) -> list[StatusClaim]:
    """Return statuses every 0.2 s until 1.6 s of a display that counts these interruptions."""
    claims, counter = [], InterruptionCounter(1e-3)
    for ms in range(1_601):
        counter.add(not any(begin < ms < end for begin, end in interruptions_ms), 1)
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


@pytest.mark.parametrize(
    ("gap", "lost", "ok"),
    [
        ((250, 900, False), 0, True),
        ((250, 900, True), 0, False),
        # The ticks between them were in a trace that did not arrive.
        ((250, 900, True), 20, True),
        # Short enough to continue without a ramp.
        ((250, 340, True), 0, None),
    ],
)
def test_a_stall_ends_by_a_ramp(gap: tuple[int, int, bool], lost: int, ok: bool | None) -> None:
    first, *_, last = counting()
    claims = [first, replace(last, ticks=last.ticks - lost)]
    gaps = [(gap[0] * MS, gap[1] * MS, gap[2])]
    assert judge_stalls("restarted", [claims], gaps, 102 * MS).ok is ok


@pytest.mark.parametrize(
    ("status", "faults", "last", "ok"),
    [
        (0, [], {}, True),
        (3, ["loop overrun"], {"faults": ["loop overrun"]}, True),
        (0, ["film's sensor: 2 gaps"], {"faults": ["film's sensor: 2 gaps"]}, True),
        (0, ["loop overrun"], {"faults": ["loop overrun"]}, False),
        (3, [], {}, False),
        (0, [], {"finger": "not pressed"}, False),
        (0, [], {"samples": SampleCounts(101, 91, 7, 2, 1, 0)}, False),
    ],
)
def test_an_exit_status_is_that_of_the_summary(
    status: int, faults: list[str], last: dict[str, Any], ok: bool
) -> None:
    final, written = replace(claim(**last), final=True), summary(faults=faults)
    assert judge_ends([("restarted", status, written, final)]).ok is ok
