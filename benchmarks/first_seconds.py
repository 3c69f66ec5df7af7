"""The first seconds of a stream under "auto": E and the errors, as the predictor learns."""

import statistics
from dataclasses import replace
from typing import NamedTuple

from benchmarks.benchmark import Benchmark
from protocol.config.scene_file import find_scene
from protocol.summary.fields import ErrorWindow
from protocol.ticks import TickState
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation

LINK = "delay=40ms,jitter=10ms,loss=1%"
SEEDS = 20
FIRST_S = 31.0
IN_PHASE_NS = 5_000_000


class Start(NamedTuple):
    """Windows of a run, and when E was first reduced, and first below 5 ms, in s of the stream."""

    windows: list[ErrorWindow]
    reduced_s: float
    in_phase_s: float


def main(benchmark: Benchmark) -> None:
    """Print E and the errors second by second, medians over the seeds."""
    seeds = 1 if benchmark.quick else benchmark.seeds or SEEDS
    starts = benchmark.run(start, range(1, seeds + 1))
    rows = []
    for each in zip(*(start.windows for start in starts), strict=False):
        delay_ms = statistics.median(window.playout_delay_ms for window in each)
        aligned, in_phase = (
            1e3 * statistics.median(error for error in errors if error is not None)
            for errors in zip(*((w.aligned_n, w.in_phase_n) for w in each), strict=True)
        )
        times = f"{each[0].from_s:.0f} to {each[0].to_s:.0f}"
        rows.append((times, f"{delay_ms:.1f}", f"{aligned:.2f}", f"{in_phase:.2f}"))
    benchmark.table(
        f"radial over {LINK}, E = auto, medians of {seeds} seeds",
        ("s", "E, ms", "aligned, mN", "in phase, mN"),
        rows,
    )
    reduced_s, in_phase_s = (
        statistics.median(getattr(start, name) for start in starts)
        for name in ("reduced_s", "in_phase_s")
    )
    print(f"E reduced after {reduced_s:.1f} s, below 5 ms after {in_phase_s:.1f} s (medians)")


def start(seed: int) -> Start:
    """Play the beginning of a stream."""
    scene = load_scene(find_scene("radial"))
    source = scene.sensing.source
    assert isinstance(source, SyntheticScene)
    sensing = scene.sensing.model_copy(update={"source": source.model_copy(update={"seed": seed})})
    ticks: list[tuple[int, bool, int]] = []

    def watch(state: TickState) -> None:
        ticks.append((state.now_ns, state.trusted, state.playout_delay_ns))

    played = replace(scene, sensing=sensing, link=parse_link(LINK))
    summary = Simulation(played, seed).run(FIRST_S, watch=watch)
    first_ns = ticks[0][0]
    reduced_ns = next((now_ns for now_ns, trusted, _ in ticks if trusted), ticks[-1][0])
    in_phase_ns = next((now for now, _, delay in ticks if delay < IN_PHASE_NS), ticks[-1][0])
    return Start(summary.windows, *((t - first_ns) * 1e-9 for t in (reduced_ns, in_phase_ns)))
