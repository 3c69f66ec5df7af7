"""The whole emulated bench against the same scene on the in-process model.

The score compares the force in the emulated motor's own record with the pulse, once the playout
delay has settled. Each half second is shifted in time to fit best: a changing delay is no error of
the drive. The display's own figure for the whole run is printed beside it.
"""

import math
import time
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from benchmarks.benchmark import Benchmark
from protocol.config.scene_file import find_scene, load_document
from protocol.faults import faults_of
from sensing_node.scene import build_source
from telepulse.scene import load_scene
from telepulse.simulation.virtual_time import Simulation
from tests.support.emulated_bench import KINDS, BenchFailedError, playing

Forces = NDArray[np.float64]

SECONDS = 15.0
RUNS = 2
# Times left out after first contact, and before the end, when the tip leaves the finger.
SETTLED_MS, LEAVING_MS = 5000, 1000
WINDOW_MS = 500
# Five beats are a breath: the pulse repeats itself.
PERIOD_MS = 4000
PRESSED_N = 0.05
SOURCE = "real_bench"


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    runs = 1 if benchmark.quick else RUNS
    pulse_n = pulse()
    with TemporaryDirectory(prefix="telepulse-") as folder:
        base_n = settled_rmse_n(model_force_n(Path(folder)), pulse_n)
    played = [play(kind) for _ in range(runs) for kind in sorted(KINDS)]
    benchmark.table(
        f"The whole emulated bench, {SECONDS:g} s a run: RMSE of the motor's own force, settled,"
        f" beside the in-process model's of {base_n * 1e3:.2f} mN; of the whole run, by the"
        " display",
        ("drive", "RMSE mN", "ratio", "whole", "samples/s", "commands/s", "missed", "on the way"),
        sorted(row(run, base_n, pulse_n) for run in played),
    )
    benchmark.judge("benches that did not play", sum(bool(run.failed) for run in played))
    rmses_n = [settled_rmse_n(run.force_n, pulse_n) for run in played if not run.failed]
    benchmark.judge("RMSE over the model's", max(rmses_n, default=math.nan) / base_n)
    # To the whole numbers that are printed: a run begins and ends within a period.
    sampled = [round(run.sampled_hz) for run in played if not run.failed]
    commanded = [round(run.commanded_hz) for run in played if not run.failed]
    benchmark.judge("samples a second", min(sampled, default=math.nan))
    benchmark.judge("commands a second", min(commanded, default=math.nan))


@dataclass(frozen=True, slots=True)
class PlayedBench:
    """A run of the bench: the motor's force, rates of samples and commands, and the summary.

    failed: why it did not play, or "".
    """

    kind: str
    force_n: Forces = field(default_factory=lambda: np.zeros(0))
    sampled_hz: float = 0.0
    summary: dict[str, Any] = field(default_factory=dict)
    failed: str = ""

    @property
    def commanded_hz(self) -> float:
        """Commands a second that reached the drive."""
        loop = self.summary["loop"]
        given = loop["ticks"] - self.summary["hardware"].get("drive superseded", 0)
        return float(given / ((loop["ticks"] + loop["deadline_misses"]) * 2e-3))


def play(kind: str) -> PlayedBench:
    """Run the bench with a kind of drive."""
    with TemporaryDirectory(prefix="telepulse-") as folder:
        try:
            with playing(Path(folder), kind, SOURCE) as bench:
                before, began_s = bench.await_state("playing"), time.monotonic()
                time.sleep(SECONDS)
                after, felt_s = bench.await_state("playing"), time.monotonic() - began_s
                summary = bench.end()
                motor = bench.motor()
        except BenchFailedError as error:
            return PlayedBench(kind, failed=str(error).splitlines()[0])
    sampled = after["samples"]["sent"] - before["samples"]["sent"]
    return PlayedBench(kind, motor.force_n, sampled / felt_s, summary)


def row(run: PlayedBench, base_n: float, pulse_n: Forces) -> tuple[str, ...]:
    """Return the row of a run."""
    if run.failed:
        return run.kind, "none", "", "", "", "", "", run.failed
    summary, rmse_n = run.summary, settled_rmse_n(run.force_n, pulse_n)
    whole_n = summary["force_rmse_n"]["aligned"] or np.nan
    on_the_way = [f"{count} {name}" for name, count in summary["hardware"].items()]
    on_the_way += map(str, faults_of(summary))
    return (
        run.kind,
        f"{rmse_n * 1e3:.2f}",
        f"{rmse_n / base_n:.2f}",
        f"{whole_n * 1e3:.2f}",
        f"{run.sampled_hz:.0f}",
        f"{run.commanded_hz:.0f}",
        str(summary["loop"]["deadline_misses"]),
        ", ".join(on_the_way) or "nothing",
    )


def pulse() -> Forces:
    """Return one period of the pulse that the board plays, in N, a value a millisecond."""
    path = find_scene(SOURCE)
    pulse_n = build_source(load_scene(path).sensing, path.parent).take(2 * PERIOD_MS)[:, 0]
    assert np.allclose(pulse_n[:PERIOD_MS], pulse_n[PERIOD_MS:])
    return pulse_n[:PERIOD_MS]


def settled_rmse_n(force_n: Forces, pulse_n: Forces) -> float:
    """Return the RMSE of a force in N, a value a millisecond, each window at its best shift."""
    pressed = np.flatnonzero(force_n > PRESSED_N)
    settled_n = force_n[pressed[0] + SETTLED_MS : pressed[-1] - LEAVING_MS]
    windows = len(settled_n) // WINDOW_MS
    squares = [
        best_square(window_n, pulse_n)
        for window_n in settled_n[: windows * WINDOW_MS].reshape(windows, WINDOW_MS)
    ]
    return float(np.sqrt(np.mean(squares)))


def best_square(window_n: Forces, pulse_n: Forces) -> float:
    """Return the least mean square, over all shifts in steps of 0.1 ms, of a window's error."""
    time_ms = np.arange(len(window_n))

    def square(shift_ms: float) -> float:
        shifted_n = np.interp(time_ms + shift_ms, np.arange(PERIOD_MS), pulse_n, period=PERIOD_MS)
        return float(np.mean((window_n - shifted_n) ** 2))

    coarse_ms = min(range(PERIOD_MS), key=square)
    return min(square(coarse_ms + tenths / 10) for tenths in range(-10, 11))


def model_force_n(folder: Path) -> Forces:
    """Return the force of the scene's models for the same pulse, without drive and sensors."""
    tables = load_document(find_scene("tmcl_bench"))
    tables["sensing"]["source"] = load_document(find_scene(SOURCE))["sensing"]["source"]
    for live in ("drive", "feedback"):
        del tables["display"][live]
    path = folder / "model.toml"
    path.write_text(tomlkit.dumps(tables), "utf-8")
    scene = load_scene(path)
    felt_n: list[float] = []
    Simulation(scene, seed=1).run(SECONDS, watch=lambda felt: felt_n.append(felt.felt_n))
    tick_ms = scene.display.tick_ns * 1e-6
    every_ms = np.arange(0.0, (len(felt_n) - 1) * tick_ms)
    force_n: Forces = np.interp(every_ms, np.arange(len(felt_n)) * tick_ms, felt_n)
    return force_n
