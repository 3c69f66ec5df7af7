"""Cost of each setting of a display, as real processes, and limits of a slow host.

Settings are the tick, the predictor, the perceived delay E, the length of a frame and the number of
connections, over one link that loses packets. Needs root, for the link emulator.
"""

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from benchmarks.benchmark import Benchmark
from benchmarks.cost import cpu_quota
from benchmarks.nodes import NodesOutcome, run_nodes
from protocol.config.scene_file import find_scene
from protocol.summary.fields import Summary
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import parse_link
from tests.support.netem import unavailable

LINK = "delay=20ms,jitter=3ms,loss=1%"
SECONDS, QUICK_S = 16.0, 8.0
# Windows that begin from here on are judged: those before it, while the display joins and
# predictors learn, and on a slow host the part without a quota, are not.
JUDGED_FROM_S = 6.0
# A host of a tenth of this machine's speed, such as a small single-board computer.
SLOW = 0.1
# Limits of what works: a tenth of the ticks missed, and the error that a finger notices, a tenth of
# the pulse's height.
MISSED, NOTICED_N = 0.1, 0.03
COLUMNS = (
    *("tick (ms)", "predictor", "E (ms)", "frame (ms)", "paths", "in phase (mN)", "aligned (mN)"),
    *("mean E (ms)", "p50 (µs)", "p99 (µs)", "missed (%)", "sensing CPU (%)", "display CPU (%)"),
    *("packets/s", "kB/s"),
)


class Settings(NamedTuple):
    """Settings of a scene; delay: as a scene has it."""

    tick_ms: float
    predictor: str
    delay: str
    batch_ms: float
    paths: int

    def toml(self) -> str:
        """Return the scene file."""
        return (
            f'extends = "radial"\n[sensing]\nbatch = "{self.batch_ms:g} ms"\n[display]\n'
            f'tick = "{self.tick_ms:g} ms"\npredictor = "{self.predictor}"\n'
            f'compensation = "{self.delay}"\npaths = {self.paths}\n'
        )


# Values that are varied one at a time, and the settings that are tried on a slow host.
VARIED: dict[str, Sequence[Any]] = {
    "tick_ms": (0.5, 1.0, 2.0, 4.0),
    "predictor": ("hold", "linear", "stack"),
    "delay": ("0 ms", "40 ms"),
    "batch_ms": (1.0, 5.0, 20.0),
    "paths": (1, 3),
}
ON_SLOW_HOST = (
    *((1.0, "stack", 5.0), (1.0, "linear", 5.0), (2.0, "stack", 5.0), (2.0, "linear", 5.0)),
    *((4.0, "stack", 5.0), (4.0, "stack", 20.0), (4.0, "linear", 20.0), (4.0, "hold", 20.0)),
)


def main(benchmark: Benchmark) -> None:
    """Run one pair of nodes at a time; print both tables."""
    if reason := unavailable():
        print(f"cost: left out: {reason}")
        return
    default, seconds = shipped(), QUICK_S if benchmark.quick else SECONDS
    varied = [default._replace(**{key: one}) for key, ones in VARIED.items() for one in ones]
    cases = [default] if benchmark.quick else list(dict.fromkeys([default, *varied]))
    benchmark.table(
        f"Real processes over {LINK}: the shipped settings, then each with one other value",
        COLUMNS,
        [_row(one, run(one, seconds), seconds) for one in cases],
        f"Errors and E are a display's own from the {JUDGED_FROM_S:g}th second on. CPU: all threads"
        " over the stream's time. Packets and bytes: both directions, with IP headers.",
    )
    if reason := cpu_quota.unavailable():
        print(f"slow host: left out: {reason}")
        return
    rows = []
    for tick_ms, predictor, batch_ms in ON_SLOW_HOST[-1:] if benchmark.quick else ON_SLOW_HOST:
        one = default._replace(tick_ms=tick_ms, predictor=predictor, batch_ms=batch_ms)
        found = run(one, seconds, SLOW)
        rows.append((*_row(one, found, seconds), "yes" if works(found) else "no"))
    benchmark.table(
        f"Each node with {100 * SLOW:g} % of a core, from the fourth second on",
        (*COLUMNS, "works"),
        rows,
        f"By a quota of cgroups: 1 ms in every {1 / SLOW:g} ms. Works: at the end fewer than"
        f" {100 * MISSED:g} % of the ticks are missed, and the aligned error is below"
        f" {NOTICED_N * 1e3:g} mN.",
    )


def shipped() -> Settings:
    """Return the settings of the default scene."""
    scene = load_scene(find_scene("radial"))
    display = scene.display
    return Settings(
        display.tick_ns * 1e-6,
        display.predictor.kind,
        "auto",
        scene.sensing.batch_ns * 1e-6,
        display.paths,
    )


def run(settings: Settings, seconds: float, share: float | None = None) -> NodesOutcome:
    """Run both nodes as processes over the link; each with a share of a core, if given."""
    with TemporaryDirectory(prefix="telepulse-") as folder:
        path = Path(folder, "scene.toml")
        path.write_text(settings.toml(), encoding="utf-8")
        link = parse_link(LINK)
        if share is None:
            return run_nodes(path, link, seconds=seconds)
        limit = partial(cpu_quota.limited, share=share)
        return run_nodes(path, link, seconds=seconds, measured=limit)


def works(run: NodesOutcome) -> bool:
    """Return whether few ticks were missed at a run's end, and its error goes unnoticed."""
    missed = run.display.loop.last_5s.missed
    _, aligned_n, _ = late_figures(run.display)
    return missed is not None and missed < MISSED and aligned_n < NOTICED_N


def late_figures(summary: Summary) -> tuple[float, float, float]:
    """Return the RMS errors in phase and aligned in N, and the mean E in ms, at the end.

    From `JUDGED_FROM_S` on, weighted by the lengths of the windows.
    """
    rows = [
        (each.in_phase_n, each.aligned_n, each.playout_delay_ms, each.to_s - each.from_s)
        for each in summary.windows
        if each.from_s >= JUDGED_FROM_S
    ]
    late = np.ma.masked_invalid(np.array(rows, np.float64).reshape(-1, 4))
    means = np.ma.average(late[:, :3] ** (2, 2, 1), axis=0, weights=late[:, 3])
    means = np.ma.filled(means, math.nan)
    return math.sqrt(means[0]), math.sqrt(means[1]), float(means[2])


def _row(one: Settings, run: NodesOutcome, seconds: float) -> tuple[str, ...]:
    """Return the cells under `COLUMNS`."""
    in_phase_n, aligned_n, delay_ms = late_figures(run.display)
    tick_us, missed = run.display.loop.tick_us, run.display.loop.last_5s.missed
    return (
        *(f"{one.tick_ms:g}", one.predictor, one.delay, f"{one.batch_ms:g}", f"{one.paths}"),
        *(f"{error_n * 1e3:.2f}" for error_n in (in_phase_n, aligned_n)),
        f"{delay_ms:z.1f}",
        *(f"{time_us or math.nan:.0f}" for time_us in (tick_us.p50, tick_us.p99)),
        "–" if missed is None else f"{100 * missed:.1f}",
        *(f"{100 * share:.1f}" for share in (run.sensing_cpu, run.display_cpu)),
        f"{run.carried.packets / seconds:.0f}",
        f"{run.carried.bytes / seconds / 1e3:.1f}",
    )
