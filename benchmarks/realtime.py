"""Tick lateness and missed ticks of a real display node, by its real-time measures.

It runs with each measure, with four together, and with none; alone, and beside as many busy
processes as there are processors. Runs take turns, so that a busy moment of the machine affects all
equally. Measures that are not granted are left out.
"""

import os
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from subprocess import PIPE
from tempfile import TemporaryDirectory

from benchmarks.benchmark import Benchmark
from benchmarks.timing import median_quantile
from display_node.doctor.jitter import busy_processes
from protocol.config.scene_file import find_scene
from protocol.host.realtime import GIVEN_UP
from protocol.summary.fields import Loop
from telepulse.processes import NodeProcess, free_addresses

SECONDS = 6.0
ROUNDS = 3
ENDS_WITHIN_S = 30.0
BARE = "bare"
QUANTILES = ("p50", "p99", "p999")
CPU = (os.cpu_count() or 1) - 1
ALONE = ("slack", "lock", f"cpu={CPU}", "fifo=40")
WISHES = {name: name for name in ALONE} | {"together": "slack,lock,fifo=40"}


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    scene = str(find_scene("radial"))
    processors = os.cpu_count() or 1
    (address,) = free_addresses(1)
    rows = []
    command = ("sensing_node.cli", scene, "--bind", address, "--quiet")
    with (
        TemporaryDirectory(prefix="telepulse-") as folder,
        NodeProcess("sensing node", *command, summary=Path(folder, "sensing.json")),
    ):
        for beside in ("nothing", "load"):
            load = busy_processes(processors) if beside == "load" else nullcontext()
            with load:
                runs: dict[str, list[Loop]] = {name: [] for name in (BARE, *WISHES)}
                for _ in range(ROUNDS):
                    for name, found in runs.items():
                        found.append(_play(scene, address, name, Path(folder, "display.json")))
            rows += [
                row(name, beside, found, runs[BARE])
                for name, found in runs.items()
                if name == BARE or all(loop.realtime for loop in found)
            ]
    benchmark.table(
        f"A display at 1 kHz beside nothing and beside a load of {processors} busy processes,"
        f" {ROUNDS} rounds of {SECONDS:g} s: lateness of ticks in µs (medians of the rounds, and"
        " the latest of all); number of rounds with fewer missed ticks than bare",
        ("with", "beside", "p50", "p99", "p99.9", "max", "missed", "of", "better in"),
        rows,
    )


def row(name: str, beside: str, found: Sequence[Loop], bare: Sequence[Loop]) -> tuple[str, ...]:
    """Return the row of a measure's rounds."""
    latest = max(loop.late_us.max or 0.0 for loop in found)
    missed = [loop.deadline_misses or 0 for loop in found]
    better = sum(
        mine < (other.deadline_misses or 0) for mine, other in zip(missed, bare, strict=True)
    )
    # In these rounds the priority was given up, so they do not measure it throughout.
    given_up = sum(GIVEN_UP in "".join(loop.realtime) for loop in found)
    return (
        name + (f", given up in {given_up}" if given_up else ""),
        beside,
        *(median_quantile(key, (loop.late_us for loop in found)) for key in QUANTILES),
        f"{latest:.0f}",
        str(sum(missed)),
        str(sum(missed) + sum(loop.ticks or 0 for loop in found)),
        "–" if name == BARE else f"{better} of {len(found)}",
    )


def _play(scene: str, address: str, wish: str, summary: Path) -> Loop:
    """Return the loop's figures of a display's run; `wish`: bare, or a key of WISHES."""
    options = [] if wish == BARE else ["--realtime", WISHES[wish]]
    with NodeProcess(
        *("display node", "display_node.cli", scene, "--connect", address, "--quiet"),
        *("--no-screen", "--seconds", str(SECONDS), *options),
        summary=summary,
        stdout=PIPE,
        stderr=PIPE,
    ) as node:
        return node.await_summary(SECONDS + ENDS_WITHIN_S).loop
