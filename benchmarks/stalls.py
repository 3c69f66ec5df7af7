"""Stalls of a host in virtual time: peak force at the finger, and how many leave the tip pressed.

Its cases: "peaks" under a pulse far steeper than a wrist's, whose host misses a number of ticks
drawn uniformly from 1 to the longest stall; "random" stalls of the display's process for hours.
"""

import time
from unittest.mock import patch

from benchmarks.benchmark import Benchmark
from display_node.control.controller import StallGuard
from protocol.config.scene_file import find_scene
from telepulse.scene import load_scene
from tests.support.fault_runs import KINDS
from tests.support.scene_loops import PEAK_N, Host, press, stalls_always, stalls_at_times
from tests.support.stall_runs import LONGEST_S, SHORTEST_S, StallCounts, StallRun

SECONDS = 30.0
SCENES = ("radial", "real_bench", "tmcl_bench")
HOSTS: dict[str, Host] = {
    "none": stalls_always(0),
    "1 to 4, 5 % of ticks": lambda rng, _: rng.randint(1, 4) if rng.random() < 0.05 else 0,
    "1 to 6, always": stalls_always(6),
    "1 to 20, always": stalls_always(20),
    "1 to 45, always": stalls_always(45),
    "1 to 45, 3 s in 10": stalls_at_times(45),
    "30, once in 5 s": lambda rng, _: 30 if rng.random() < 2e-4 else 0,
}
# Seeds of random stalls, and virtual time that is run with each: three hours in all.
SEEDS, CHUNK_S = 36, 300.0


def main(benchmark: Benchmark) -> None:
    """Print the tables of the chosen cases."""
    benchmark.run_parts({"peaks": peaks, "random": random_stalls})


def peaks(benchmark: Benchmark) -> None:
    """Print the peak force with and without the guard against stalls; the limit is 2.5 N."""
    rows, seconds = [], 12.0 if benchmark.quick else SECONDS
    for name in SCENES:
        scene = load_scene(find_scene(name)).display
        for stalls, host in HOSTS.items():
            most_n, rmse_n = press(scene, host, seconds)
            with patch.object(StallGuard, "tick", lambda *_: None):
                free_most_n, free_rmse_n = press(scene, host, seconds)
            cells = (f"{most_n:.2f}", f"{free_most_n:.2f}")
            errors = (f"{rmse_n * 1e3:.2f}", f"{free_rmse_n * 1e3:.2f}")
            rows.append((name, stalls, *cells, *errors))
    benchmark.table(
        f"Stalls of a host, {seconds:g} s each: a beat of {PEAK_N} N is wanted",
        ("scene", "ticks missed", "most N", "unguarded", "RMSE mN", "unguarded"),
        rows,
    )


def chunk(job: tuple[str, bool, int, float]) -> StallCounts:
    """Run one seed."""
    kind, with_film, seed, seconds = job
    return StallRun(kind, with_film, seed).run(seconds)


def random_stalls(benchmark: Benchmark) -> None:
    """Print how many random stalls leave the tip withdrawn, played on, or pressed."""
    began_s, count = time.perf_counter(), 1 if benchmark.quick else benchmark.seeds or SEEDS
    seconds = 10.0 if benchmark.quick else CHUNK_S
    # Most benches have a film.
    jobs = [
        (KINDS[seed % len(KINDS)], seed // len(KINDS) % 4 != 3, seed, seconds)
        for seed in range(count)
    ]
    total = StallCounts()
    for counts in benchmark.run(chunk, jobs):
        total.add(counts)
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
    benchmark.judge("stalls that leave the tip pressed", total.pressed.total())
