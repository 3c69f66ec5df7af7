"""`python -m fuzz`: fuzz all targets for a limited time, and print a verdict."""

import importlib.util
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Annotated

import typer

from fuzz.run import Outcome, run_target
from fuzz.targets import NAMES
from protocol.host.child_process import python_command

# Bytes of the input and lines of the log that are shown of a crash.
SHOWN_BYTES = 512
SHOWN_LINES = 20


def fuzz(
    seconds: Annotated[float, typer.Option(min=1, help="At work, for all targets together.")] = 60,
    only: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A target; give several for more.")
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Targets at once.")] = os.cpu_count() or 1,
    out: Annotated[Path, typer.Option(help="Corpora, crashes and logs.")] = Path("out/fuzz"),
) -> None:
    """Fuzz all code that reads foreign input.

    Inputs that reach new code are kept, and the next run starts from them. Exit status 1 when an
    input makes a target raise an unexpected error, take too much memory or too long.
    """
    names = only or list(NAMES)
    unknown = sorted(set(names) - set(NAMES))
    if unknown:
        _fail(f"no target {unknown[0]}; known: {', '.join(NAMES)}")
    if importlib.util.find_spec("atheris") is None:
        _fail("atheris is missing: pip install 'telepulse[fuzz]', where there is a wheel of it")
    jobs = min(jobs, len(names))
    each_s = max(1, round(seconds * jobs / len(names)))
    print(f"{'target':<16}{'inputs':>12}{'a second':>10}{'features':>10}{'peak':>9}  crashes")
    began_s = time.monotonic()
    outcomes = []
    with ThreadPoolExecutor(jobs) as pool:
        for outcome in pool.map(lambda name: run_target(name, each_s, out / name), names):
            outcomes.append(outcome)
            print(_row(outcome), flush=True)
    raise SystemExit(_judge(outcomes, time.monotonic() - began_s))


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
