"""Recordings as a display's telemetry makes them, without a display."""

from collections.abc import Container, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.tactile import ElasticLayer
from protocol.ticks import TickState
from protocol.wire.description import Channel, StreamDescription
from protocol.wire.messages import ClockReply, Frame, Welcome, encode_control, encode_frame
from protocol.wire.telemetry import CONTROL
from telepulse.recording.mcap_writer import McapWriter
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import EVENT, TICK
from tests.support.streams import synthetic
from tests.support.telemetry_publisher import WALL_NS, HandmadeTelemetry
from tests.support.tick_blocks import TRACE_TICKS

TICK_NS = 1_000_000
BATCH, CLOCK_TICKS, STATUS_TICKS, DELAY_TICKS, RAMP_TICKS = 5, 50, 200, 40, 1_000
GAIN = 1.001
TICKS_A_CHUNK = 500
BEGIN_NS, UNIX_NS, AHEAD_NS = 10**12, WALL_NS, 5 * 10**12
DESCRIPTION = StreamDescription("radial pulse", TICK_NS, BATCH, (Channel("pulse"),), ElasticLayer())
Samples = NDArray[np.float32]


def record(
    path: Path,
    seconds: int,
    lost: Container[int] = (),
    marks: Mapping[int, str] = {},
    about: dict[str, str] | None = None,
    whole_run: Mapping[str, Any] = {},
    missed: Container[int] = (),
) -> None:
    """Record a pulse that is felt 40 ms later, without the frames of the numbers in `lost`.

    missed: ticks that the display missed. marks: texts by tick. about: what a person states.
    whole_run: tables of the display's summary.
    """
    force_n = synthetic().take(seconds * 1000)[:, 0].astype("<f4")
    writer = McapWriter(path)
    if about is not None:
        writer.state(about)
    for tick, entries in _telemetry(force_n, lost, whole_run, missed):
        for entry in entries:
            writer.add(entry)
        for at, text in marks.items():
            if tick == at + TRACE_TICKS and entries and entries[-1].topic == TICK:
                t_ns = UNIX_NS + BEGIN_NS + at * TICK_NS
                writer.add(Entry(EVENT, t_ns, {"level": 2, "name": "mark", "message": text}))
        if tick % TICKS_A_CHUNK == 0:
            writer.flush()
    writer.close()


def _telemetry(
    force_n: Samples, lost: Container[int], whole_run: Mapping[str, Any], missed: Container[int]
) -> Iterator[tuple[int, list[Entry]]]:
    """Yield entries, with the number of ticks until then."""
    telemetry = HandmadeTelemetry()
    welcome = encode_control(Welcome(1, 0, DESCRIPTION))
    yield 0, telemetry.receive((CONTROL, welcome), at_ns=BEGIN_NS)
    for end in range(TRACE_TICKS, len(force_n) + 1, TRACE_TICKS):
        ticks = range(end - TRACE_TICKS, end)
        for tick in ticks:
            messages = _arriving(tick, force_n, lost)
            yield tick, telemetry.receive(*messages, at_ns=BEGIN_NS + tick * TICK_NS)
        yield end, telemetry.ticks(*(_felt(tick, force_n) for tick in ticks if tick not in missed))
        if end % STATUS_TICKS == 0:
            yield end, telemetry.status("playing", **whole_run)
    yield len(force_n), telemetry.status("ended", final=True, **whole_run)


def _arriving(tick: int, force_n: Samples, lost: Container[int]) -> Iterator[tuple[int, bytes]]:
    sensing_ns = BEGIN_NS + tick * TICK_NS + AHEAD_NS
    if tick % CLOCK_TICKS == 0:
        asked_ns = sensing_ns - AHEAD_NS - 300_000
        reply = ClockReply(1, asked_ns, sensing_ns - 150_000, sensing_ns - 150_000)
        yield CONTROL, encode_control(reply)
    first = tick - BATCH
    if tick % BATCH == 0 and first >= 0 and first // BATCH not in lost:
        values = force_n[first:tick, np.newaxis]
        yield 0, encode_frame(Frame(1, first, sensing_ns - BATCH * TICK_NS, TICK_NS, values))


def _felt(tick: int, force_n: Samples) -> TickState:
    """Return a tick that plays the force of 40 ms ago, slightly too strong."""
    now_ns, played = BEGIN_NS + tick * TICK_NS, tick - DELAY_TICKS
    target_n = float(force_n[played]) if played >= 0 else 0.0
    instant_ns = now_ns + AHEAD_NS - DELAY_TICKS * TICK_NS
    felt_n, full = GAIN * target_n, played >= RAMP_TICKS
    return TickState(now_ns, now_ns + AHEAD_NS, instant_ns, target_n, felt_n, full)
