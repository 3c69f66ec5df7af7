"""Random stalls of the display's process, in virtual time: how many leave the tip pressed.

`python -m benchmarks.random_stalls HOURS` runs for HOURS instead of three hours.
"""

import math
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor

from benchmarks.benchmark import Benchmark
from tests.support.fault_runs import KINDS
from tests.support.stall_runs import LONGEST_S, SHORTEST_S, StallCounts, StallRun

HOURS = 3.0
# Virtual time that is run with one seed.
CHUNK_S = 300.0


def chunk(kind: str, with_film: bool, seed: int) -> StallCounts:
    """Run one seed."""
    return StallRun(kind, with_film, seed).run(CHUNK_S)


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    began_s, count = time.perf_counter(), math.ceil(HOURS * 3600 / CHUNK_S)
    # Most benches have a film.
    jobs = [(KINDS[seed % 2], seed // 2 % 4 != 3, seed) for seed in range(count)]
    total = StallCounts()
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for counts in pool.map(chunk, *zip(*jobs, strict=True)):
            total.add(counts)
            done = f"{total.virtual_s / 3600:.2f} h: {total.episodes.total()} episodes"
            print(f"{done}, {total.pressed.total()} left pressed", file=sys.stderr)
    took_s = time.perf_counter() - began_s
    columns = (total.episodes, total.withdrawn, total.played, total.pressed)
    names = sorted(total.episodes)
    rows = [(name, *(str(column[name]) for column in columns)) for name in names]
    rows.append(("all", *(str(column.total()) for column in columns)))
    benchmark.table(
        f"Random stalls of {SHORTEST_S:g} to {LONGEST_S:g} s in {total.virtual_s / 3600:.1f} h of"
        f" virtual time ({took_s / 60:.0f} min); greatest force {total.most_n:.2f} N",
        ("stalled", "episodes", "withdrawn", "played", "left pressed"),
        rows,
    )
    for example in total.examples[:10]:
        print(example)
