"""Recordings as a display's telemetry makes them, without a display."""

from collections.abc import Container, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from protocol.run_summary import Summary
from protocol.tactile import ElasticLayer
from protocol.wire.messages import ClockReply, Frame, Welcome, encode_control, encode_frame
from protocol.wire.stream import Channel, StreamDescription
from protocol.wire.telemetry import (
    CAPTURE,
    CONTROL,
    STATUS,
    SUBSCRIBED,
    TRACE,
    CaptureWriter,
    PlaybackStatus,
    TickState,
    TraceWriter,
    pack_status,
)
from telepulse.recording.mcap_writer import McapWriter
from telepulse.telemetry.decoder import TelemetryDecoder
from tests.support.streams import synthetic

TICK_NS = 1_000_000
BATCH, CLOCK_TICKS, STATUS_TICKS, DELAY_TICKS, RAMP_TICKS = 5, 50, 200, 40, 1_000
GAIN = 1.001
MESSAGES_A_CHUNK = 50
BEGIN_NS, UNIX_NS, AHEAD_NS = 10**12, 1_700_000_000 * 10**9, 5 * 10**12
DESCRIPTION = StreamDescription("radial pulse", TICK_NS, BATCH, (Channel("pulse"),), ElasticLayer())
PLAYING = PlaybackStatus(0, 1.0, DESCRIPTION.layer.strain_per_newton, "linear", 60_000_000)
Samples = NDArray[np.float32]


def record(path: Path, seconds: int, lost: Container[int] = ()) -> None:
    """Record a pulse that is felt 40 ms later, without the frames of the numbers in `lost`."""
    force_n = synthetic().take(seconds * 1000)[:, 0].astype("<f4")
    writer, decoder = McapWriter(path), TelemetryDecoder()
    for number, (topic, message) in enumerate(_telemetry(force_n, lost)):
        for entry in decoder.decode(topic, message):
            writer.add(entry)
        if number % MESSAGES_A_CHUNK == 0:
            writer.flush()
    writer.close()


def _telemetry(force_n: Samples, lost: Container[int]) -> Iterator[tuple[bytes, bytes]]:
    capture, traces = CaptureWriter(run=1), TraceWriter()
    capture.follow(SUBSCRIBED)
    capture.add(BEGIN_NS, CONTROL, encode_control(Welcome(1, 0, DESCRIPTION)))
    for tick in range(len(force_n)):
        now_ns = BEGIN_NS + tick * TICK_NS
        for path, message in _arriving(tick, force_n, lost):
            capture.add(now_ns, path, message)
        trace = traces.add(_felt(tick, force_n))
        if trace is not None:
            for message in capture.take(now_ns, UNIX_NS + now_ns):
                yield CAPTURE, message
            yield TRACE, trace
            capture.traces_published += 1
        if tick % STATUS_TICKS == STATUS_TICKS - 1:
            yield STATUS, _status("playing", final=False)
            capture.statuses_published += 1
    yield STATUS, _status("ended", final=True)


def _status(state: str, final: bool) -> bytes:
    return pack_status(state, DESCRIPTION.name, Summary(), final, 1, playing=PLAYING)


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
    felt_n, scored = GAIN * target_n, played >= RAMP_TICKS
    return TickState(now_ns, now_ns + AHEAD_NS, instant_ns, target_n, felt_n, scored)
