"""`python -m fuzz`: fuzz all targets for a limited time, and print a verdict."""

import importlib.util
import os
import re
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from subprocess import TimeoutExpired
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer

from fuzz.board import search_board
from fuzz.targets import NAMES
from protocol.host.child_process import ChildProcess, python_command

# Bytes of the input and lines of the log that are shown of a crash.
SHOWN_BYTES = 512
SHOWN_LINES = 20
LONGEST_INPUT_BYTES = 4096
USUAL_S = 60.0
# No target of bytes.
BOARD = "board"
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


def fuzz(
    only: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]...", help="Targets, or board alone.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=1, help="At work, for all targets together.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Targets at once.")] = os.cpu_count() or 1,
    out: Annotated[Path, typer.Option(help="Corpora, crashes and logs.")] = Path("out/fuzz"),
) -> None:
    """Fuzz all code that reads foreign input.

    Inputs that reach new code are kept, and the next run starts from them. Exit status 1 when an
    input makes a target raise an unexpected error, take too much memory or too long. board is the
    finger's board, under commands and inputs.
    """
    if only == [BOARD]:
        raise SystemExit(search_board(seconds, jobs))
    names = only or list(NAMES)
    unknown = sorted(set(names) - set(NAMES))
    if unknown:
        _fail(f"no target {unknown[0]}; known: {', '.join(NAMES)}; or {BOARD}, alone")
    if importlib.util.find_spec("atheris") is None:
        _fail("atheris is missing: pip install 'telepulse[fuzz]', where there is a wheel of it")
    jobs = min(jobs, len(names))
    each_s = max(1, round((seconds or USUAL_S) * jobs / len(names)))
    print(f"{'target':<16}{'inputs':>12}{'a second':>10}{'features':>10}{'peak':>9}  crashes")
    began_s = time.monotonic()
    outcomes = []
    with ThreadPoolExecutor(jobs) as pool:
        for outcome in pool.map(lambda name: _run_target(name, each_s, out / name), names):
            outcomes.append(outcome)
            print(_row(outcome), flush=True)
    raise SystemExit(_judge(outcomes, time.monotonic() - began_s))


def _run_target(name: str, seconds: int, folder: Path) -> Outcome:
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


def _row(outcome: Outcome) -> str:
    return (
        f"{outcome.name:<16}{outcome.inputs:>12,}{outcome.per_second:>10,}"
        f"{outcome.features:>10,}{outcome.peak_mb:>6} MB  {int(outcome.failed)}"
    )


def _judge(outcomes: Sequence[Outcome], elapsed_s: float) -> int:
    """Print the crashes and the verdict; return the exit status."""
    crashed = [outcome for outcome in outcomes if outcome.failed]
    for outcome in crashed:
        _show(outcome)
    inputs = sum(outcome.inputs for outcome in outcomes)
    print(
        f"{'FAIL' if crashed else 'ok'}: {inputs:,} inputs on {len(outcomes)} targets"
        f" in {elapsed_s:.0f} s, {len(crashed)} crashes"
    )
    return 1 if crashed else 0


def _show(outcome: Outcome) -> None:
    """Print a crash: the end of the log, the input, and how to reproduce it."""
    lines = outcome.log.read_text(encoding="utf-8", errors="replace").splitlines()
    print(f"\n{outcome.name}: the end of {outcome.log}:")
    print("\n".join("    " + line[:200] for line in _run_end(lines)[-SHOWN_LINES:]))
    if outcome.crash is not None:
        data = outcome.crash.read_bytes()
        more = f" and {len(data) - SHOWN_BYTES} bytes more" if len(data) > SHOWN_BYTES else ""
        print(f"input: {data[:SHOWN_BYTES].hex()}{more}")
        command = python_command("-m", "fuzz.target", outcome.name, str(outcome.crash))
        print(f"again: {' '.join(command)}")


def _run_end(lines: list[str]) -> list[str]:
    """Return the log up to where libFuzzer ends its run: the exception and its origin."""
    ends = (at for at, line in enumerate(lines) if "ERROR: libFuzzer" in line)
    return lines[: next(ends, len(lines))]


def _fail(reason: str) -> None:
    print(f"fuzz: {reason}", file=sys.stderr)
    raise SystemExit(2)


if __name__ == "__main__":
    typer.run(fuzz)
