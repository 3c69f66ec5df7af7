"""What it takes to report and to export an hour's recording: time, memory, size."""

import math
import os
import tempfile
from collections.abc import Container, Iterator
from pathlib import Path
from subprocess import DEVNULL

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import show
from protocol.host.child_process import ChildProcess
from protocol.run_summary import Summary
from protocol.tactile import ElasticLayer
from protocol.wire.messages import ClockReply, Frame, Welcome, encode_control, encode_frame
from protocol.wire.status import STATUS, PlaybackStatus, pack_status
from protocol.wire.stream import Channel, StreamDescription
from protocol.wire.telemetry import (
    CONTROL,
    HEARD,
    SUBSCRIBED,
    TRACE,
    CaptureWriter,
    TickState,
    TraceWriter,
)
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource
from telepulse.recording.mcap_writer import McapWriter
from telepulse.telemetry.decoder import TelemetryDecoder

SECONDS = 3_600
TICK_NS = 1_000_000
BATCH, CLOCK_TICKS, STATUS_TICKS, DELAY_TICKS, RAMP_TICKS = 5, 50, 200, 40, 1_000
GAIN = 1.001
MESSAGES_A_CHUNK = 50
BEGIN_NS, UNIX_NS, AHEAD_NS = 10**12, 1_700_000_000 * 10**9, 5 * 10**12
WORK = (
    ("report",),
    ("export", "--to", "csv"),
    ("export", "--to", "parquet"),
    ("export", "--to", "edf"),
)
DESCRIPTION = StreamDescription("radial pulse", TICK_NS, BATCH, (Channel("pulse"),), ElasticLayer())
Samples = NDArray[np.float32]
# ru_maxrss is in kB on Linux.
MB = 1e-3


def main() -> None:
    """Print the table."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="telepulse-") as folder:
        path = Path(folder, "hour.mcap")
        record(path, SECONDS)
        for command, *options in WORK:
            name = "-".join((command, *options))
            out = Path(folder, name)
            work_s, most_mb = run(command, str(path), *options, "--out", str(out))
            figures = (work_s, most_mb, size_mb(out))
            rows.append((" ".join((command, *options)), *(f"{figure:.0f}" for figure in figures)))
        title = f"A recording of {SECONDS} s, {path.stat().st_size * 1e-6:.0f} MB"
    show(title, ("telepulse", "s of a core", "most memory, MB", "written, MB"), rows)


def record(path: Path, seconds: int, lost: Container[int] = ()) -> None:
    """Such a recording as a display's telemetry makes it: a pulse, felt 40 ms later.

    lost: numbers of frames that never come.
    """
    pulse = SyntheticSource(SyntheticScene.model_validate({"kind": "synthetic"}))
    force_n = pulse.take(seconds * 1000)[:, 0].astype("<f4")
    writer, decoder = McapWriter(path), TelemetryDecoder()
    for number, (topic, message) in enumerate(telemetry(force_n, lost)):
        for entry in decoder.decode(topic, message):
            writer.add(entry)
        if number % MESSAGES_A_CHUNK == 0:
            writer.flush()
    writer.close()


def telemetry(force_n: Samples, lost: Container[int]) -> Iterator[tuple[bytes, bytes]]:
    """The messages of a run: topic and data."""
    heard, traces = CaptureWriter(run=1), TraceWriter()
    heard.follow(SUBSCRIBED)
    heard.add(BEGIN_NS, CONTROL, encode_control(Welcome(1, 0, DESCRIPTION)))
    for tick in range(len(force_n)):
        now_ns = BEGIN_NS + tick * TICK_NS
        for path, message in arriving(tick, force_n, lost):
            heard.add(now_ns, path, message)
        trace = traces.add(felt(tick, force_n))
        if trace is not None:
            for message in heard.take(now_ns, UNIX_NS + now_ns):
                yield HEARD, message
            yield TRACE, trace
            heard.traces += 1
        if tick % STATUS_TICKS == STATUS_TICKS - 1:
            yield STATUS, status("playing", final=False)
            heard.statuses += 1
    yield STATUS, status("ended", final=True)


def status(state: str, final: bool) -> bytes:
    """A word of the display's of itself."""
    playing = PlaybackStatus(0, 1.0, DESCRIPTION.layer.strain_per_newton, "linear", 60_000_000)
    return pack_status(state, DESCRIPTION.name, Summary(), final, 1, playing=playing)


def arriving(tick: int, force_n: Samples, lost: Container[int]) -> Iterator[tuple[int, bytes]]:
    """What comes with a tick: path and message."""
    now_ns = BEGIN_NS + tick * TICK_NS
    sensing_ns = now_ns + AHEAD_NS
    if tick % CLOCK_TICKS == 0:
        reply = ClockReply(1, now_ns - 300_000, sensing_ns - 150_000, sensing_ns - 150_000)
        yield CONTROL, encode_control(reply)
    first = tick - BATCH
    if tick % BATCH == 0 and first >= 0 and first // BATCH not in lost:
        values = force_n[first:tick, np.newaxis]
        yield 0, encode_frame(Frame(1, first, sensing_ns - BATCH * TICK_NS, TICK_NS, values))


def felt(tick: int, force_n: Samples) -> TickState:
    """A tick that plays what was sensed 40 ms ago, a little too strong."""
    now_ns, played = BEGIN_NS + tick * TICK_NS, tick - DELAY_TICKS
    sensing_ns = now_ns + AHEAD_NS
    target_n = float(force_n[played]) if played >= 0 else 0.0
    instant_ns = sensing_ns - DELAY_TICKS * TICK_NS
    return TickState(
        now_ns, sensing_ns, instant_ns, target_n, GAIN * target_n, played >= RAMP_TICKS
    )


def run(*arguments: str) -> tuple[float, float]:
    """Run a command of telepulse; its time on a core in s, and the most memory it had in MB."""
    process = ChildProcess("command", "-m", "telepulse", *arguments, stdout=DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"benchmarks: {' '.join(arguments)} failed")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * MB


def size_mb(path: Path) -> float:
    """Of a file, or of a folder's files."""
    files = [path] if path.is_file() else list(path.iterdir())
    return math.fsum(file.stat().st_size for file in files) * 1e-6
