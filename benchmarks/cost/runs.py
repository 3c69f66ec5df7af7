"""Settings of a scene, and what a run with them costs: in virtual time, and as real processes."""

import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

from benchmarks.cost import cpu_quota
from protocol.config.scene_file import find_scene
from protocol.histogram import Histogram
from protocol.summary.tables import Summary
from protocol.ticks import TickState
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation
from tests.support.netem import NodesOutcome, run_nodes

LINK = "delay=20ms,jitter=3ms,loss=1%"
# A host of a tenth of this machine's speed, such as a small single-board computer.
SLOW = 0.1
# An error below 1 % of the pulse's height counts as none, since a finger notices a tenth. Times
# that differ by less than this share are equal: they are not measured better on a busy machine.
NO_ERROR_N = 0.003
EQUAL = 0.1


class Settings(NamedTuple):
    """Settings of a scene; delay_ms None is E = auto."""

    tick_ms: float
    predictor: str
    delay_ms: float | None
    batch_ms: float
    paths: int

    def __str__(self) -> str:
        delay = "auto" if self.delay_ms is None else f"{self.delay_ms:g} ms"
        return (
            f"tick {self.tick_ms:g} ms, {self.predictor}, E {delay}, frames of"
            f" {self.batch_ms:g} ms, paths {self.paths}"
        )

    def cells(self) -> tuple[str, ...]:
        """Return the cells under `NAMED`."""
        delay = "auto" if self.delay_ms is None else f"{self.delay_ms:g}"
        return f"{self.tick_ms:g}", self.predictor, delay, f"{self.batch_ms:g}", f"{self.paths}"

    def toml(self) -> str:
        """Return the scene file."""
        delay = "auto" if self.delay_ms is None else f"{self.delay_ms:g} ms"
        return (
            f'extends = "radial"\n[sensing]\nbatch = "{self.batch_ms:g} ms"\n[display]\n'
            f'tick = "{self.tick_ms:g} ms"\npredictor = "{self.predictor}"\n'
            f'compensation = "{delay}"\npaths = {self.paths}\n'
        )


def shipped() -> Settings:
    """Return the settings of the default scene."""
    scene = load_scene(find_scene("radial"))
    display, delay_ns = scene.display, scene.display.compensation_ns
    return Settings(
        display.tick_ns * 1e-6,
        display.predictor.kind,
        None if delay_ns is None else delay_ns * 1e-6,
        scene.sensing.batch_ns * 1e-6,
        display.paths,
    )


@dataclass(frozen=True, slots=True)
class Effort:
    """Values to combine in virtual time, and to vary one at a time with real processes.

    seconds, settle_seconds: scored time of a simulation, after that in which predictors learn.
    live_seconds: duration of a run with real processes. slow: the settings to try on a slow host.
    """

    ticks_ms: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0)
    predictors: tuple[str, ...] = ("hold", "linear", "stack")
    delays_ms: tuple[float | None, ...] = (None, 0.0, 40.0)
    batches_ms: tuple[float, ...] = (1.0, 5.0, 20.0)
    paths: tuple[int, ...] = (1, 3)
    seconds: float = 10.0
    settle_seconds: float = 10.0
    live_seconds: float = 16.0
    slow: tuple[tuple[float, str, float], ...] = (
        (1.0, "stack", 5.0),
        (1.0, "linear", 5.0),
        (2.0, "stack", 5.0),
        (2.0, "linear", 5.0),
        (4.0, "stack", 20.0),
        (4.0, "linear", 20.0),
        (4.0, "hold", 20.0),
    )

    def combinations(self) -> list[Settings]:
        """Return all combinations with the shipped paths, and the shipped settings with others."""
        default = shipped()
        crossed = product(self.ticks_ms, self.predictors, self.delays_ms, self.batches_ms)
        found = [Settings(*values, default.paths) for values in crossed]
        found += [default._replace(paths=paths) for paths in self.paths]
        return list(dict.fromkeys([default, *found]))

    def variations(self) -> list[Settings]:
        """Return the shipped settings, and each with one other value."""
        default = shipped()
        found = [default]
        found += [default._replace(tick_ms=value) for value in self.ticks_ms]
        found += [default._replace(predictor=value) for value in self.predictors]
        found += [default._replace(delay_ms=value) for value in self.delays_ms]
        found += [default._replace(batch_ms=value) for value in self.batches_ms]
        found += [default._replace(paths=value) for value in self.paths]
        return list(dict.fromkeys(found))


QUICK = Effort(
    ticks_ms=(),
    predictors=(),
    delays_ms=(),
    batches_ms=(),
    paths=(),
    seconds=1.0,
    settle_seconds=1.0,
    live_seconds=7.0,
    slow=((4.0, "hold", 20.0),),
)


class SimulatedCost(NamedTuple):
    """Result of a simulation.

    in_phase_n, aligned_n: RMS errors. delay_ms: mean E. p50_us, p99_us: processor time of a tick,
    with the sensing node, the link and the scoring. load: processor time over the stream's.
    frames_per_s: received frames, with copies.
    """

    in_phase_n: float
    aligned_n: float
    delay_ms: float
    p50_us: float
    p99_us: float
    load: float
    frames_per_s: float

    def objectives(self) -> tuple[float, ...]:
        """Return what should be small."""
        errors = (max(NO_ERROR_N, error) for error in (self.in_phase_n, self.aligned_n))
        return (*errors, self.load, self.frames_per_s)


def pareto_front(points: Sequence[Sequence[float]], equal: float = EQUAL) -> list[bool]:
    """Return for each point whether no other dominates it.

    A point dominates another if no coordinate is larger by more than the share `equal`, and at
    least one is smaller by more than that.
    """

    def dominates(one: Sequence[float], other: Sequence[float]) -> bool:
        pairs = list(zip(one, other, strict=True))
        not_worse = all(mine <= theirs * (1 + equal) for mine, theirs in pairs)
        return not_worse and any(mine * (1 + equal) < theirs for mine, theirs in pairs)

    return [not any(dominates(other, point) for other in points) for point in points]


def simulate_cost(settings: Settings, effort: Effort) -> SimulatedCost:
    """Simulate settings. Raises SceneError."""
    with tempfile.TemporaryDirectory(prefix="telepulse-") as folder:
        path = Path(folder, "scene.toml")
        path.write_text(settings.toml(), encoding="utf-8")
        scene = replace(load_scene(path), link=parse_link(LINK + ",transport=tcp"))
    simulation, tick_us = Simulation(scene, seed=1), Histogram(5.0, 2_000)
    last_ns = 0

    def watch(_: TickState) -> None:
        nonlocal last_ns
        now_ns = time.thread_time_ns()
        if last_ns:
            tick_us.add((now_ns - last_ns) * 1e-3)
        last_ns = time.thread_time_ns()

    seconds = effort.settle_seconds + effort.seconds
    summary = simulation.run(seconds, effort.settle_seconds, watch)
    frames = (summary.frames.received or 0) + (summary.frames.copies or 0)
    return SimulatedCost(
        summary.force_rmse_n.in_phase or math.nan,
        summary.force_rmse_n.aligned or math.nan,
        late_delay_ms(summary, 0.0),
        tick_us.quantile(0.5) or math.nan,
        tick_us.quantile(0.99) or math.nan,
        (tick_us.mean or math.nan) * 1e-3 / settings.tick_ms,
        frames / seconds,
    )


def run_live(settings: Settings, seconds: float, share: float | None = None) -> NodesOutcome:
    """Run both nodes as processes over an emulated link; each with a share of a core, if given.

    Raises EmulatorError or ProcessError.
    """
    with tempfile.TemporaryDirectory(prefix="telepulse-") as folder:
        path = Path(folder, "scene.toml")
        path.write_text(settings.toml(), encoding="utf-8")
        link = parse_link(LINK)
        if share is None:
            return run_nodes(path, link, seconds=seconds)
        limit = partial(cpu_quota.limited, share=share)
        return run_nodes(path, link, seconds=seconds, measured=limit)


def late_errors_n(summary: Summary, from_s: float) -> tuple[float, float]:
    """Return the RMS errors in phase and aligned of the windows from a time on."""
    windows = [window for window in summary.windows if window.from_s >= from_s]

    def pooled(name: str) -> float:
        known = [
            (error_n, window.to_s - window.from_s)
            for window in windows
            if (error_n := getattr(window, name)) is not None
        ]
        total_s = sum(length_s for _, length_s in known)
        squares = sum(error_n**2 * length_s for error_n, length_s in known)
        return math.sqrt(squares / total_s) if total_s else math.nan

    return pooled("in_phase_n"), pooled("aligned_n")


def late_delay_ms(summary: Summary, from_s: float) -> float:
    """Return the mean perceived delay of the windows from a time on."""
    windows = [window for window in summary.windows if window.from_s >= from_s]
    total_s = sum(window.to_s - window.from_s for window in windows)
    delays = sum(window.playout_delay_ms * (window.to_s - window.from_s) for window in windows)
    return delays / total_s if total_s else math.nan
