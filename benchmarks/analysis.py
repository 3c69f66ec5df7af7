"""Time, memory and size of the reports and exports of an hour's recording."""

import math
import os
import tempfile
from pathlib import Path
from subprocess import DEVNULL

from benchmarks.benchmark import Benchmark
from protocol.host.child_process import ChildProcess
from tests.support.recordings import record

SECONDS = 3_600
COMMANDS = (
    ("report",),
    ("export", "--to", "csv"),
    ("export", "--to", "parquet"),
    ("export", "--to", "edf"),
)
# ru_maxrss is in kB on Linux.
MB = 1e-3


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="telepulse-") as folder:
        path = Path(folder, "hour.mcap")
        record(path, SECONDS)
        for command, *options in COMMANDS:
            out = Path(folder, "-".join((command, *options)))
            core_s, most_mb = run(command, str(path), *options, "--out", str(out))
            figures = (core_s, most_mb, size_mb(out))
            rows.append((" ".join((command, *options)), *(f"{figure:.0f}" for figure in figures)))
        title = f"A recording of {SECONDS} s, {path.stat().st_size * 1e-6:.0f} MB"
    benchmark.table(title, ("telepulse", "s of a core", "most memory, MB", "written, MB"), rows)


def run(*arguments: str) -> tuple[float, float]:
    """Run a command of telepulse; return its time on a core in s and its peak memory in MB."""
    process = ChildProcess("command", "-m", "telepulse", *arguments, stdout=DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"benchmarks: {' '.join(arguments)} failed")
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss * MB


def size_mb(path: Path) -> float:
    """Return the size of a file, or of a folder's files."""
    files = [path] if path.is_file() else list(path.iterdir())
    return math.fsum(file.stat().st_size for file in files) * 1e-6
