"""Time and memory until the first sample of a long file can be played."""

import tempfile
import time
from pathlib import Path
from subprocess import PIPE

import numpy as np

from benchmarks.benchmark import Benchmark
from protocol.host.child_process import ChildProcess

DAY_S, HOUR_S, RATE_HZ = 86_400, 3_600, 1_000
# Samples that are written at once: whole beats of 0.8 s.
PART = 800_000
FIRST_SAMPLE = """
import sys
from pathlib import Path
from sensing_node.sources.choice import record_table
from sensing_node.sources.recorded import RecordedSource, RecordingScene
table, _ = record_table(Path(sys.argv[1]))
RecordedSource(RecordingScene.model_validate(table | {"rate": "1 kHz"}), Path()).take(1)
# Of this program alone: ru_maxrss has that of the one which started it, too.
print(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
"""


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="telepulse-") as folder:
        for name, kind, seconds in (
            ("a day, .npy of 32-bit floats", "<f4", DAY_S),
            ("a day, .npy of 16-bit integers", "<i2", DAY_S),
            ("an hour, .csv with times", "", HOUR_S),
        ):
            path = Path(folder, "pulse.npy" if kind else "pulse.csv")
            write(path, kind, seconds * RATE_HZ)
            start_s, most_mb = first_sample(path)
            size_mb = path.stat().st_size * 1e-6
            rows.append((name, f"{size_mb:.0f}", f"{start_s:.1f}", f"{most_mb:.0f}"))
    columns = ("file at 1 kHz", "size, MB", "until the first sample, s", "most memory, MB")
    benchmark.table("A long file as a source", columns, rows)


def write(path: Path, kind: str, samples: int) -> None:
    """Write a pulse of 75 beats a minute as an array of a kind of numbers, or as text."""
    beat_s = np.arange(PART) / RATE_HZ % 0.8
    pulse = 1000 * np.exp(-(((beat_s - 0.3) / 0.08) ** 2))
    if kind:
        array = np.lib.format.open_memmap(path, "w+", kind, (samples,))
        for first in range(0, samples, PART):
            array[first : first + PART] = pulse[: samples - first]
        return
    with path.open("w", encoding="ascii") as file:
        file.write("t [s],force [mN]\n")
        for at in range(samples):
            file.write(f"{at / RATE_HZ:.3f},{pulse[at % PART]:.2f}\n")


def first_sample(path: Path) -> tuple[float, float]:
    """Play the first sample in a process; return its whole time in s and its peak memory in MB."""
    began_s = time.perf_counter()
    with ChildProcess("player", "-c", FIRST_SAMPLE, str(path), stdout=PIPE) as process:
        printed, _ = process.communicate()
    if process.returncode:
        raise SystemExit(f"benchmarks: {path} cannot be played")
    return time.perf_counter() - began_s, int(printed) * 1e-3
