"""Faults of nodes, networks and peers: time until the pulse is felt again, unaccounted samples.

Some need root, for the link emulator.
"""

import random
import statistics
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.benchmark import Benchmark
from benchmarks.faults.backlog import backlogs
from benchmarks.faults.cases import CASES, NEEDS_EMULATOR, FaultResult
from tests.support.netem import unavailable

TIMES = 6
SEED = 1
BAR_MS = 1_000.0
FORCE_LIMIT_N, SLEW_LIMIT_N_PER_S = 2.5, 50.0


def main(benchmark: Benchmark) -> None:
    """Print the table.

    The bars: felt again within 1 s, no sample unaccounted for, no force and no slew of the target
    beyond the scene's limits.
    """
    reason = unavailable()
    rows = []
    for number, (name, case) in enumerate(CASES.items()):
        if case in NEEDS_EMULATOR and reason is not None:
            print(f"{name}: left out: {reason}")
            continue
        with TemporaryDirectory(prefix="telepulse-") as folder:
            rows.append(row(name, case(Path(folder), TIMES, random.Random(SEED + number))))
    backlogs(benchmark)
    benchmark.table(
        f"{TIMES} times each, radial.toml, links of 20±3 ms or this machine alone: ms from its end"
        f" until the pulse is felt again, median and most (bar {BAR_MS:g}); share of the time that"
        " it was felt meanwhile; samples that no count names (bar 0); most force, most slew of the"
        f" target and felt (limits {FORCE_LIMIT_N:g} N, {SLEW_LIMIT_N_PER_S:g} N/s)",
        ("fault", "median", "most", "felt", "missing", "N", "N/s target", "N/s felt"),
        rows,
    )


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
