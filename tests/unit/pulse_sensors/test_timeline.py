import numpy as np
import pytest

from pulse_sensors.reading import JUMP_NS, Span, Timeline

MS = 1_000_000
START_NS = 77_000_000_123
SECOND_NS = 1_000_000_000


def spans(timeline: Timeline, count: int, period_ns: float, jitter_ns: float = 0) -> list[Span]:
    """Packets of 4 samples, measured with jitter."""
    rng = np.random.default_rng(1)
    placed = []
    for first in range(0, count, 4):
        last_ns = START_NS + round((first + 3) * period_ns + rng.uniform(0, jitter_ns))
        span = timeline.place(4, 0, last_ns)
        assert span is not None
        placed.append(span)
    return placed


def test_samples_on_time_lie_where_they_were_measured() -> None:
    for number, span in enumerate(spans(Timeline(MS), 1000, MS)):
        assert span == (START_NS + 4 * number * MS, START_NS + (4 * number + 4) * MS, 0)


@pytest.mark.parametrize("rate_hz", [700, 990, 1000, 1000.3, 1300])
def test_the_true_rate_is_found_and_the_jitter_taken_out(rate_hz: float) -> None:
    timeline = Timeline(MS)
    placed = spans(timeline, 20_000, 1e9 / rate_hz, jitter_ns=8 * MS)
    assert timeline.rate_hz == pytest.approx(rate_hz, rel=1e-3)
    times = np.array([span.first_ns for span in placed[2500:]]) - START_NS
    off_ns = times - np.arange(4 * 2500, 20_000, 4)[: len(times)] * 1e9 / rate_hz
    assert off_ns.std() < 0.25 * MS  # of 2.3 ms as measured
    assert off_ns.mean() == pytest.approx(4 * MS, abs=0.3 * MS)


def test_a_row_is_without_gaps_and_never_steps_back_whatever_is_measured() -> None:
    timeline, rng, end_ns = Timeline(MS), np.random.default_rng(2), None
    for number in range(2000):
        span = timeline.place(1, 0, START_NS + number * MS + int(rng.normal(0, 60 * MS)))
        if span is None:
            continue
        assert span.end_ns > span.first_ns
        if end_ns is not None and not span.missing:
            assert span.first_ns == end_ns
            assert 0.3 * MS < span.end_ns - span.first_ns < 2 * MS
        end_ns = span.end_ns


def test_packets_that_all_come_far_too_early_are_placed() -> None:
    timeline, end_ns = Timeline(MS), START_NS - 2 * MS
    # By the time that was expected, nothing passes from the last but one to the last.
    early = ((2, 0, 0), (1, 2, 0), (1, 0, 1), (3, 1, 1), (5, 0, 2), (1, 0, 3), (2, 1, 3), (2, 0, 4))
    for count, missing, at_ms in early:
        span = timeline.place(count, missing, START_NS + at_ms * MS)
        assert span is not None
        assert end_ns < span.end_ns
        end_ns = span.end_ns


def test_known_gaps_keep_their_room() -> None:
    timeline = Timeline(MS)
    spans(timeline, 100, MS)
    assert timeline.place(1, 7, START_NS + 107 * MS) == Span(
        START_NS + 107 * MS, START_NS + 108 * MS, 7
    )


def test_a_jump_of_the_time_shows_what_is_missing() -> None:
    timeline = Timeline(MS)
    spans(timeline, 100, MS)
    span = timeline.place(1, 0, START_NS + 5100 * MS)
    assert span == Span(START_NS + 5100 * MS, START_NS + 5101 * MS, 5000)


def test_what_lies_far_behind_has_no_place_and_changes_nothing() -> None:
    timeline = Timeline(MS)
    spans(timeline, 1000, MS)
    assert timeline.place(1, 0, START_NS + 999 * MS - JUMP_NS) is None
    assert timeline.place(1, 0, START_NS + 1000 * MS) == Span(
        START_NS + 1000 * MS, START_NS + 1001 * MS, 0
    )
