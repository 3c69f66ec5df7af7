"""Telemetry that contradicts itself or holds no numbers, before every reader of it.

`tests/system/hostile` tries any telemetry on the same readers.
"""

import math

import pytest

from fuzz.telemetry_readers import AHEAD_NS, TelemetryReaders, preamble, status_message
from protocol.summary.fields import Summary
from protocol.ticks import TickState
from tests.support.given_faults import FILM_LOST
from tests.support.telemetry_publisher import MS, PLAYING, Message, trace_message


def readers_after(*messages: Message) -> TelemetryReaders:
    """Return every reader after these messages."""
    readers = TelemetryReaders()
    for message in messages:
        readers.take(*message)
    return readers


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
    readers = readers_after(*preamble(), status_message("playing", *signals))
    for tick in range(100):
        readers.take(*trace_message(TickState(tick * MS), others=states))
    readers.take(*status_message("playing", *signals, contactors=figures))
    readers.draw()
    assert len(readers.live.contactors) == min(played_on, 8)
    assert readers.live.beyond == max(0, played_on - 8)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_a_force_that_becomes_unknown_is_a_gap_and_the_panel_goes_on(value: float) -> None:
    readers = readers_after(*preamble())
    play(readers, range(0, 3_000))
    play(readers, range(3_000, 4_000), felt_n=value)
    line = readers.screen.line()
    readers.take(*status_message("fault", faults=[FILM_LOST]))
    readers.draw()
    assert line.startswith("playing: felt unknown of ")
    assert "heart rate" not in line
