"""Run one target in a process of its own for a limited time, and read its log."""

import os
import re
from dataclasses import dataclass
from pathlib import Path
from subprocess import TimeoutExpired
from tempfile import TemporaryDirectory
from typing import Any

from protocol.host.child_process import ChildProcess

LONGEST_INPUT_BYTES = 4096
LONGEST_INPUT_S = 10
MOST_MEMORY_MB = 1024
# Time to load and to end, on a busy machine.
PATIENCE_S = 300
_FEATURES = re.compile(r"cov: \d+ ft: (\d+)")
_STATISTIC = re.compile(r"stat::(\w+):\s+(\d+)")
_WRITTEN = re.compile(r"Test unit written to (\S+)")


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of one target. features: number of paths through its code that were reached.

    failed: it did not end normally. crash: the input at which it failed, if known.
    """

    name: str
    inputs: int
    per_second: int
    features: int
    peak_mb: int
    failed: bool
    crash: Path | None
    log: Path


def run_target(name: str, seconds: int, folder: Path) -> Outcome:
    """Fuzz a target for `seconds`; `folder` keeps its corpus, its log and its crash."""
    corpus, log = folder / "corpus", folder / "log.txt"
    corpus.mkdir(parents=True, exist_ok=True)
    command = [
        *("-m", "fuzz.target", name, str(corpus)),
        *(f"-max_total_time={seconds}", f"-timeout={LONGEST_INPUT_S}", "-print_final_stats=1"),
        *(f"-max_len={LONGEST_INPUT_BYTES}", f"-rss_limit_mb={MOST_MEMORY_MB}"),
        f"-artifact_prefix={folder}/",
    ]
    with log.open("w", encoding="utf-8") as file, TemporaryDirectory() as scratch:
        # Threads of numerical libraries would only take memory.
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "1", "TMPDIR": scratch}
        streams: dict[str, Any] = {"stdout": file, "stderr": file}
        # Ctrl-C ends the target, too.
        with ChildProcess(name, *command, own_session=False, env=environment, **streams) as target:
            try:
                failed = target.wait(seconds + PATIENCE_S) != 0
            except TimeoutExpired as error:
                file.write(f"\nfuzz: {error}\n")
                failed = True
    return _outcome(name, log, failed)


def _outcome(name: str, log: Path, failed: bool) -> Outcome:
    text = log.read_text(encoding="utf-8", errors="replace")
    statistics = {key: int(value) for key, value in _STATISTIC.findall(text)}
    written = _WRITTEN.findall(text)
    return Outcome(
        name,
        statistics.get("number_of_executed_units", 0),
        statistics.get("average_exec_per_sec", 0),
        max(map(int, _FEATURES.findall(text)), default=0),
        statistics.get("peak_rss_mb", 0),
        failed,
        Path(written[-1]) if failed and written else None,
        log,
    )
