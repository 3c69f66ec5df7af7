"""Live sensors: errors of timestamps due to USB's batches, and cost of a sample.

The times are computed in virtual time, where the time of each sample is known. The cost is CPU
time: of decoding alone, and of a whole sensing node that reads an emulated board.
"""

import os
import tempfile
import time
from itertools import accumulate
from pathlib import Path
from subprocess import DEVNULL
from typing import NamedTuple

import numpy as np

from benchmarks.benchmark import Benchmark
from benchmarks.timing import time_call
from protocol.config.scene import validate
from protocol.host.child_process import ChildProcess
from pulse_sensors.samples import Timestamper
from pulse_sensors.serial_port import SerialScene
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource
from telepulse.emulators.sensor_board import (
    BoardBehaviour,
    Encode,
    SensorBoard,
    binary,
    line,
    source_table,
    timed_line,
)
from telepulse.processes import NodeProcess, free_addresses

SECONDS, SETTLED_S = 60, 5
SKEW = 200e-6
NODE_S = 10
# The cost of a run of this length is subtracted: interpreter, imports and start.
SHORT_S = 1
TABLE = {"kind": "serial", "port": "none", "rate": "1 kHz", "unit": "N"}


class Kind(NamedTuple):
    """A format of samples, and the keys of the scene that reads it."""

    name: str
    encode: Encode
    frame: int
    keys: dict[str, str]


def main(benchmark: Benchmark) -> None:
    """Print both tables."""
    kinds = (
        Kind("binary", binary("float32"), 4, {"framing": "binary"}),
        Kind("text with time", timed_line, 1, {"framing": "text", "device_time": "us"}),
        Kind("text", line, 1, {"framing": "text"}),
    )
    columns = ("framing", "as it arrives, ms", "as streamed, ms", "worst", "late by", "skew, ppm")
    title = f"Timestamps of 1 kHz through 16 ms USB, after {SETTLED_S} s, device {SKEW * 1e6:g} ppm"
    benchmark.table(title, columns, [times(kind) for kind in kinds])
    rows = [(kind.name, f"{decoding_us(kind):.2f}", "") for kind in kinds]
    for name, framing in (
        ("synthetic, node", None),
        ("binary, node", "binary"),
        ("text, node", "text"),
    ):
        cpu_us = node_us(framing)
        rows.append((name, f"{cpu_us:.1f}", f"{cpu_us / 1000:.1%}"))
    benchmark.table("CPU of a sample", ("", "µs a sample", "of a core at 1 kHz"), rows)


def times(kind: Kind) -> tuple[str, ...]:
    """Return the standard deviation of the times before and after, and their error."""
    board, scene = _board(kind, 0, SKEW), validate(TABLE | kind.keys, SerialScene, "benchmark")
    decoder, timestamper = scene.decoder(), Timestamper(scene)
    decoder.feed(b"\0" if kind.name == "binary" else b"\n")
    timestamped, arrivals_ns = [], []
    while (now_ns := board.next_delivery_ns) < SECONDS * 1_000_000_000:
        for block in decoder.feed(board.deliver(now_ns)):
            reading = timestamper.timestamp(block, now_ns)
            assert reading is not None
            timestamped.append(reading)
            arrivals_ns.append(now_ns)
    ends = accumulate(len(reading.force_n) + reading.missing for reading in timestamped)
    numbers = [end - len(reading.force_n) for end, reading in zip(ends, timestamped, strict=True)]
    true_ns = np.array([board.taken_ns(number) for number in numbers])
    kept = true_ns > SETTLED_S * 1_000_000_000
    raw_ms = (np.array(arrivals_ns) - true_ns)[kept] * 1e-6
    off_ms = (np.array([reading.first_ns for reading in timestamped]) - true_ns)[kept] * 1e-6
    worst_ms = abs(off_ms - off_ms.mean()).max()
    figures = (raw_ms.std(), off_ms.std(), worst_ms, off_ms.mean())
    skew = f"{timestamper.skew_ppm:.1f}" if kind.name != "text" else ""
    return (kind.name, *(f"{figure:.3f}" for figure in figures), skew)


def decoding_us(kind: Kind) -> float:
    """Return the cost of a sample from bytes to readings, in chunks as USB delivers them."""
    board, scene = _board(kind, 0, SKEW), validate(TABLE | kind.keys, SerialScene, "benchmark")
    chunks = list[tuple[bytes, int]]()
    while len(chunks) < 100:
        now_ns = board.next_delivery_ns
        chunks.append((board.deliver(now_ns), now_ns))

    def decode() -> None:
        decoder, timestamper = scene.decoder(), Timestamper(scene)
        for data, now_ns in chunks:
            for block in decoder.feed(data):
                timestamper.timestamp(block, now_ns)

    return time_call(decode).median_us / board.sampled


def node_us(framing: str | None) -> float:
    """Return the CPU time of a sensing node for a sample; None: of a synthetic source."""
    with tempfile.TemporaryDirectory() as folder:
        link, scene = Path(folder, "board"), Path(folder, "scene.toml")
        if framing is None:
            scene.write_text('[sensing.source]\nkind = "synthetic"\n', encoding="utf-8")
            return _difference_us(scene)
        scene.write_text(source_table(link, 1000, framing, "float32"), encoding="utf-8")
        command = ("-m", "telepulse", "emulate", "sensor", "--link", str(link))
        with ChildProcess("board", *command, "--framing", framing, stdout=DEVNULL) as board:
            while not link.exists():
                time.sleep(0.05)
            difference_us = _difference_us(scene)
            board.stop()
        return difference_us


def _difference_us(scene: Path) -> float:
    longer_s, shorter_s = (_cpu_s(scene, seconds) for seconds in (NODE_S, SHORT_S))
    return (longer_s - shorter_s) / (NODE_S - SHORT_S) * 1e3


def _cpu_s(scene: Path, seconds: int) -> float:
    (address,) = free_addresses(1)
    arguments = (str(scene), "--bind", address, "--seconds", str(seconds), "--quiet")
    child = NodeProcess(
        "sensing node", "sensing_node.cli", *arguments, summary=scene.with_suffix(".json")
    )
    _, status, used = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"the sensing node ended with status {child.returncode}")
    return used.ru_utime + used.ru_stime


def _board(kind: Kind, start_ns: int, skew: float) -> SensorBoard:
    scene = SyntheticScene.model_validate({"kind": "synthetic"})
    return SensorBoard(
        SyntheticSource(scene), kind.encode, BoardBehaviour(kind.frame, skew), start_ns
    )
