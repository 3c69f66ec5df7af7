"""Any telemetry leaves every reader of it running, in bounded time and memory, and a force that is
no number is drawn as a gap."""

import math
import resource
from collections.abc import Iterator
from contextlib import contextmanager

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzz.telemetry_readers import AHEAD_NS, TelemetryReaders, preamble, status_message
from protocol.summary.tables import (
    Clock,
    Summary,
)
from protocol.ticks import TickState
from protocol.wire.messages import Frame
from protocol.wire.telemetry import TRACE, PlaybackStatus
from tests.support.telemetry_publisher import (
    MS,
    PLAYING,
    SESSION,
    WALL_NS,
    Message,
    heard_message,
    trace_message,
)

MOST_MORE_BYTES = 1 << 30
AWKWARD = [math.nan, math.inf, -math.inf, 1e300, -1e300, 5e-324, 1e15, 1e6, -1e6, 0.0, 0.3]
awkward = st.sampled_from(AWKWARD) | st.floats()
times_ns = (
    st.integers(0, 3_000).map(lambda ms: ms * MS)
    | st.sampled_from([-(2**63), -1, 0, 2**62 - 1, 2**62, 2**63 - 1])
    | st.integers(-(2**62), 2**62 - 1)
)
counts = st.integers(0, 10_000) | st.sampled_from([-1, 2**53 - 1, 2**53, 2**63 - 1])
words = st.sampled_from(["waiting", "starting", "playing", "stale", "ended", "fault", "", "\x1b["])

ticks = st.builds(TickState, times_ns, times_ns, times_ns, awkward, awkward, st.booleans(), awkward)
near_ticks = st.builds(
    lambda ms, felt_n, scored: TickState(ms * MS, 0, ms * MS + AHEAD_NS, 0.3, felt_n, scored),
    *(st.integers(0, 3_000), awkward, st.booleans()),
)
# States of further contactors, whose number need not be that of the status.
others = st.lists(ticks | near_ticks, max_size=3) | st.lists(near_ticks, min_size=9, max_size=70)
traces = st.builds(
    lambda felt, others: trace_message(*felt, others=others),
    *(st.lists(ticks | near_ticks, max_size=25), others),
)
names = words | st.sampled_from(["cun", "guan", "<b>", "fault", "\u202ex", "x" * 81])
played = st.builds(
    PlaybackStatus, names, st.integers(-1, 70), awkward, awkward, words, times_ns, times_ns
)
near_played = st.builds(
    PlaybackStatus,
    st.sampled_from(["cun", "guan", "<b>", "fault"]) | st.integers(0, 99).map(str),
    *(st.integers(0, 3), st.floats(-2, 2), st.floats(-2, 2), words),
    *(st.just(60 * MS), st.just(8 * MS)),
)


def _name(playing: PlaybackStatus) -> str:
    return playing.contactor


playing = (
    st.lists(st.just(PLAYING) | played, max_size=3)
    | st.lists(near_played, max_size=3, unique_by=_name)
    | st.lists(near_played, min_size=7, max_size=70, unique_by=_name)
)
statuses = st.builds(lambda state, playing: status_message(state, *playing), words, playing)
samples = st.integers(1, 3).flatmap(
    lambda channels: st.lists(
        st.lists(awkward, min_size=channels, max_size=channels), min_size=1, max_size=5
    ).map(lambda rows: np.array(rows, "<f8"))
)
frames = st.builds(
    Frame,
    *(st.just(SESSION), st.integers(0, 2_000)),
    st.integers(0, 3_000).map(lambda ms: ms * MS + AHEAD_NS) | times_ns,
    *(st.just(MS), samples),
)
captures = st.builds(
    heard_message, frames, times_ns, times_ns, st.just(WALL_NS) | times_ns, st.integers(1, 2)
)
EMPTY = TRACE, msgpack.packb([b"", b""])


def garbage(data: bytes) -> Message:
    return TRACE, data


messages = st.lists(
    traces | statuses | captures | st.just(EMPTY) | st.binary().map(garbage),
    max_size=12,
)


@contextmanager
def little_memory() -> Iterator[None]:
    """Limit the memory, so that a reader which fills it fails with a MemoryError."""
    with open("/proc/self/statm", encoding="ascii") as statm:
        present = int(statm.read().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (present + MOST_MORE_BYTES, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def readers_after(*messages: Message) -> TelemetryReaders:
    """Return every reader after these messages."""
    readers = TelemetryReaders()
    for message in messages:
        readers.take(*message)
    return readers


@settings(deadline=None, max_examples=25)
@given(messages)
def test_every_reader_survives_any_telemetry(published: list[Message]) -> None:
    with little_memory():
        readers = readers_after(*preamble(), *published)
        readers.draw()


def pulse_n(tick: int) -> float:
    return 0.3 + 0.1 * math.sin(2 * math.pi * 1.25e-3 * tick)


def play(readers: TelemetryReaders, ticks: range, felt_n: float | None = None) -> None:
    """Send the traces of a pulse, a tick each ms; felt_n: the felt force in its place."""
    for first in range(ticks.start, ticks.stop, 20):
        felt = [
            TickState(
                tick * MS,
                tick * MS + AHEAD_NS,
                (tick - 40) * MS + AHEAD_NS,
                pulse_n(tick),
                pulse_n(tick) if felt_n is None else felt_n,
                felt_n is None,
            )
            for tick in range(first, first + 20)
        ]
        readers.take(*trace_message(*felt))


@pytest.mark.parametrize("ticked", [1, 2, 12])
@pytest.mark.parametrize("played_on", [1, 2, 12])
def test_traces_and_statuses_may_disagree_on_the_number_of_contactors(
    ticked: int, played_on: int
) -> None:
    signals = [PLAYING._replace(contactor=f"<i>{n}</i>", channel=n) for n in range(played_on)]
    states = [TickState(target_n=0.3, felt_n=0.1 * n) for n in range(1, ticked)]
    figures = {f"<i>{n}</i>": Summary(within_jnd=0.5) for n in range(ticked)}
    with little_memory():
        readers = readers_after(*preamble(), status_message("playing", *signals))
        for tick in range(100):
            readers.take(*trace_message(TickState(tick * MS), others=states))
        readers.take(*status_message("playing", *signals, contactors=figures))
        readers.draw()
    assert len(readers.live.contactors) == min(played_on, 8)
    assert readers.live.beyond == max(0, played_on - 8)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_a_force_that_becomes_unknown_is_a_gap_and_the_panel_goes_on(value: float) -> None:
    with little_memory():
        readers = readers_after(*preamble())
        play(readers, range(0, 3_000))
        play(readers, range(3_000, 4_000), felt_n=value)
        line = readers.screen.line()
        readers.take(*status_message("fault", faults=["feedback lost"]))
        readers.draw()
    assert line.startswith("playing: felt unknown of ")
    assert "heart rate" not in line


@pytest.mark.parametrize("figure", AWKWARD)
def test_a_summary_holds_no_figure_that_is_none(figure: float) -> None:
    table = Summary(within_jnd=figure, clock=Clock(figure, figure)).to_dict()
    for value in (table["within_jnd"], *table["clock"].values()):
        assert value is None or abs(value) <= 1e15
