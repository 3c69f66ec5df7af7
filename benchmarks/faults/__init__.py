"""Faults of nodes, networks and peers: time until the pulse is felt again, unaccounted samples.

Its cases: "faults" of every kind, "cuts" of seven kinds many times each, "reconnections" where
nothing is cut, and "floods" of a peer. Some need root, for the link emulator.
"""

import random
import statistics
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.benchmark import Benchmark
from benchmarks.faults import cuts, flood
from benchmarks.faults.cases import CASES, NEEDS_EMULATOR, FaultResult
from tests.support.netem import unavailable

TIMES = 6
SEED = 1


def main(benchmark: Benchmark) -> None:
    """Print the tables of the chosen cases."""
    benchmark.run_parts(
        {
            "faults": each_fault,
            "cuts": cuts.each_kind,
            "reconnections": cuts.where_nothing_is_cut,
            "floods": flood.floods,
        }
    )


def each_fault(benchmark: Benchmark) -> None:
    """Make every fault several times."""
    reason, times = unavailable(), 1 if benchmark.quick else TIMES
    rows, results = [], []
    for number, (name, case) in enumerate(CASES.items()):
        if case in NEEDS_EMULATOR and reason is not None:
            print(f"{name}: left out: {reason}")
            continue
        with TemporaryDirectory(prefix="telepulse-") as folder:
            results.append(case(Path(folder), times, random.Random(SEED + number)))
        rows.append(row(name, results[-1]))
    benchmark.table(
        f"{times} times each, radial.toml, links of 20±3 ms or this machine alone: ms from its end"
        " until the pulse is felt again, median and most; share of the time that it was felt"
        " meanwhile; samples that no count names; most force, most slew of the target and felt",
        ("fault", "median", "most", "felt", "missing", "N", "N/s target", "N/s felt"),
        rows,
    )
    back_ms = [each for found in results for each in found.back_ms]
    benchmark.judge("time until the pulse is felt again after a fault", 1e-3 * max(back_ms))
    benchmark.judge("samples that no count names", sum(found.unaccounted for found in results))
    benchmark.judge("force at the finger", max(found.peaks[0] for found in results))
    benchmark.judge("slew of the target", max(found.peaks[1] for found in results))


def row(name: str, found: FaultResult) -> tuple[str, ...]:
    """Return a fault's row of the table."""
    back_ms = found.back_ms
    force_n, target, felt = found.peaks
    return (
        name,
        f"{statistics.median(back_ms):.0f}" if back_ms else "–",
        f"{max(back_ms):.0f}" if back_ms else "–",
        "–" if found.felt is None else f"{100 * found.felt:.1f} %",
        str(found.unaccounted),
        f"{force_n:.2f}",
        f"{target:.1f}",
        f"{felt:.1f}",
    )
