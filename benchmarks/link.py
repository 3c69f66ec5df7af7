"""Error of the felt force at each delay, buffered and predicted, over five links.

The perceived delay E is the part of a link's delay that is buffered; the rest is predicted. Each
case runs both nodes in virtual time.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from benchmarks.benchmark import Benchmark
from display_node.prediction import PredictorName
from display_node.prediction.scene import own_predictor
from display_node.scoring.tracking_error import JND
from protocol.config.scene_file import find_scene
from protocol.tactile import matching_force_ratio
from protocol.ticks import TickState
from sensing_node.scene import build_source, describe_stream
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PREDICTORS: tuple[PredictorName, ...] = ("hold", "linear", "stack")


class LinkSpec(NamedTuple):
    """A link as `parse_link` reads it, and the perceived delays in ms to run on it."""

    text: str
    delays_ms: tuple[float, ...]


LAN, NEAR, FAR = "LAN", "20 ± 3 ms, 1 % lost", "40 ± 10 ms"
BURSTS, TCP = "20 ms with bursts", "TCP, 40 ms, 1 % lost"
LINKS: dict[str, LinkSpec] = {
    LAN: LinkSpec("delay=0.5ms,jitter=0.2ms", (0, 4, 8, 12)),
    NEAR: LinkSpec("delay=20ms,jitter=3ms,loss=1%", (0, 10, 20, 30, 40)),
    FAR: LinkSpec("delay=40ms,jitter=10ms", (0, 20, 40, 60, 80)),
    BURSTS: LinkSpec("delay=20ms,jitter=10ms,jitter_kind=bursts", (0, 20, 40, 80, 120)),
    TCP: LinkSpec("delay=40ms,jitter=3ms,loss=1%,transport=tcp", (0, 40, 80, 120, 160)),
}


@dataclass(frozen=True, slots=True)
class Effort:
    """Simulated links; `settle_seconds` in which predictors learn, then scored `seconds`."""

    seconds: float = 15.0
    settle_seconds: float = 20.0
    seeds: tuple[int, ...] = (1, 2)
    links: tuple[str, ...] = tuple(LINKS)


QUICK = Effort(seconds=1.0, settle_seconds=1.0, seeds=(1,), links=(LAN,))


class LinkCase(NamedTuple):
    """A link as `parse_link` reads it, a predictor, a perceived delay E and a seed.

    delay_ms is None where the display chooses E. The seed is the link's and the pulse's.
    """

    link: str
    predictor: PredictorName
    delay_ms: float | None
    seed: int = 1

    def __str__(self) -> str:
        delay = "auto" if self.delay_ms is None else f"{self.delay_ms:g} ms"
        return f"{self.predictor} at E = {delay} over {self.link}, seed {self.seed}"


class LinkResult(NamedTuple):
    """Errors and delays of a case.

    Attributes
    ----------
    in_phase_n, aligned_n
        RMS difference in N from the present pulse, and from the pulse E before.
    deviation_n, peak_to_peak_n
        Standard deviation and height of the pulse itself, scaled as felt, in N.
    delay_ms
        Mean perceived delay E, which is buffered.
    horizon_ms, longest_ms
        Mean and largest age of the newest sample over the played instant, which is predicted.
    predicted
        Share of the ticks without a sample.
    felt
        Share of the time in which the pulse was felt; in the rest missing samples had faded it out.
    roughness
        Energy of the felt force above 25 Hz over the pulse's.
    lost
        Share of the samples that were lost.
    """

    in_phase_n: float
    aligned_n: float
    deviation_n: float
    peak_to_peak_n: float
    delay_ms: float
    horizon_ms: float
    longest_ms: float
    predicted: float
    felt: float
    roughness: float
    lost: float

    @property
    def in_phase(self) -> float:
        """NRMSE against the present pulse."""
        return self.in_phase_n / self.deviation_n

    @property
    def aligned(self) -> float:
        """NRMSE against the pulse E before."""
        return self.aligned_n / self.deviation_n

    @property
    def in_phase_jnd(self) -> float:
        """Error in phase over the just noticeable difference in force."""
        return self.in_phase_n / (JND * self.peak_to_peak_n)


# By predictor and perceived delay; None: chosen by the display.
Curves = dict[PredictorName, dict[float | None, LinkResult]]


def main(benchmark: Benchmark) -> None:
    """Run every case; print the tables."""
    effort = QUICK if benchmark.quick else Effort()
    if benchmark.seeds is not None:
        effort = replace(effort, seeds=tuple(range(1, benchmark.seeds + 1)))
    results = score_links(benchmark, effort)
    _show_choices(benchmark, results)
    for number, (link, curves) in enumerate(results.items(), 1):
        _show_curves(benchmark, link, curves)
        benchmark.plot(str(number), partial(_draw, link=link, curves=curves))


def score_links(benchmark: Benchmark, effort: Effort) -> dict[str, Curves]:
    """Return the results of every case by link, the seeds pooled."""
    grid = [
        (name, predictor, delay_ms)
        for name in effort.links
        for predictor in PREDICTORS
        for delay_ms in (*LINKS[name].delays_ms, None)
    ]
    cases = [
        LinkCase(LINKS[name].text, predictor, delay_ms, seed)
        for name, predictor, delay_ms in grid
        for seed in effort.seeds
    ]
    ran = iter(benchmark.run(partial(run_link, effort=effort), cases))
    results: dict[str, Curves] = {
        name: {predictor: {} for predictor in PREDICTORS} for name in effort.links
    }
    for name, predictor, delay_ms in grid:
        results[name][predictor][delay_ms] = pooled([next(ran) for _ in effort.seeds])
    return results


def run_link(case: LinkCase, effort: Effort) -> LinkResult:
    """Simulate a case. Raises SceneError."""
    scene = load_scene(find_scene("radial"))
    source = scene.sensing.source.model_copy(update={"seed": case.seed})
    delay_ns = None if case.delay_ms is None else round(case.delay_ms * 1e6)
    display = {"predictor": own_predictor(case.predictor), "compensation_ns": delay_ns}
    scene = replace(
        scene,
        sensing=scene.sensing.model_copy(update={"source": source}),
        display=scene.display.model_copy(update=display),
        link=parse_link(case.link),
    )
    simulation = Simulation(scene, case.seed)
    delays_ns, horizons_ns = [], []

    def watch(tick: TickState) -> None:
        newest_ns = simulation.newest_ns
        if newest_ns is not None:
            delays_ns.append(tick.playout_delay_ns)
            horizons_ns.append(max(0, tick.instant_ns - newest_ns))

    summary = simulation.run(effort.settle_seconds + effort.seconds, effort.settle_seconds, watch)
    samples, errors, horizon_ns = summary.samples, summary.force_rmse_n, np.array(horizons_ns)
    # The force that should be felt in the scored time.
    sensed = build_source(scene.sensing, scene.path.parent)
    channel = describe_stream(scene.sensing, sensed).find(scene.display.channel)
    rate_hz = 1e9 / sensed.period_ns
    sensed.take(round(effort.settle_seconds * rate_hz))
    wrist_n = sensed.take(round(effort.seconds * rate_hz))[:, channel]
    pulse_n = wrist_n * matching_force_ratio(
        scene.sensing.layer.layer(), scene.display.layer.layer()
    )
    return LinkResult(
        in_phase_n=errors.in_phase or math.nan,
        aligned_n=errors.aligned or math.nan,
        deviation_n=float(pulse_n.std()),
        peak_to_peak_n=float(np.ptp(pulse_n)),
        delay_ms=float(np.mean(delays_ns)) * 1e-6,
        horizon_ms=float(horizon_ns.mean()) * 1e-6,
        longest_ms=float(horizon_ns.max()) * 1e-6,
        predicted=float(np.mean(horizon_ns > 0)),
        felt=len(delays_ns) * scene.display.tick_ns * 1e-9 / effort.seconds,
        roughness=summary.roughness.energy_ratio or math.nan,
        lost=(samples.lost or 0) / (samples.sent or 1),
    )


def pooled(results: Sequence[LinkResult]) -> LinkResult:
    """Pool the results of several seeds: forces by root mean square, the rest by the mean."""
    values = {}
    for name in LinkResult._fields:
        column = np.array([getattr(result, name) for result in results])
        is_force = name.endswith("_n")
        values[name] = float(np.sqrt(np.mean(column**2)) if is_force else column.mean())
    return LinkResult(**values)._replace(longest_ms=max(one.longest_ms for one in results))


def _show_choices(benchmark: Benchmark, results: dict[str, Curves]) -> None:
    rows = []
    for link, curves in results.items():
        for predictor, curve in curves.items():
            tried = {delay_ms: each for delay_ms, each in curve.items() if delay_ms is not None}
            best_ms = min(tried, key=lambda delay_ms: tried[delay_ms].in_phase_n)
            auto = curve[None]
            rows.append((link, predictor, f"{best_ms:g}", *_figures(tried[best_ms])))
            rows.append((link, predictor, f"auto: {auto.delay_ms:.1f}", *_figures(auto)))
    columns = ("predicted (ms)", "of ticks (%)", "in phase (mN)", "JND", "aligned (mN)")
    benchmark.table(
        "The delay with the least error in phase, and the choice of auto",
        ("link", "predictor", "E (ms)", *columns, "above 25 Hz", "felt (%)", "lost (%)"),
        rows,
        "In phase: against the present pulse; aligned: against the pulse E before. JND: error in"
        " phase over a tenth of the pulse's peak to peak. Predicted: mean age of the newest sample"
        " over the played instant. Above 25 Hz: energy of the felt force over the pulse's.",
    )


def _figures(result: LinkResult) -> tuple[str, ...]:
    return (
        f"{result.horizon_ms:.1f}",
        f"{100 * result.predicted:.0f}",
        f"{result.in_phase_n * 1e3:.1f}",
        f"{result.in_phase_jnd:.2f}",
        f"{result.aligned_n * 1e3:.1f}",
        f"{result.roughness:.1f}",
        f"{100 * result.felt:.1f}",
        f"{100 * result.lost:.1f}",
    )


def _show_curves(benchmark: Benchmark, link: str, curves: Curves) -> None:
    rows = []
    for delay_ms, result in curves[PREDICTORS[0]].items():
        if delay_ms is None:
            continue
        errors = [
            f"{curve[delay_ms].in_phase:.3f} / {curve[delay_ms].aligned:.3f}"
            for curve in curves.values()
        ]
        rows.append(
            (f"{delay_ms:g}", f"{result.horizon_ms:.1f}", f"{result.longest_ms:.0f}", *errors)
        )
    title = f"{link}: error in phase / aligned over the pulse's standard deviation"
    columns = ("E (ms)", "predicted (ms)", "at most (ms)", *curves)
    benchmark.table(title, columns, rows)


def _draw(figure: "Figure", link: str, curves: Curves) -> None:
    """Draw the errors in phase and aligned against the perceived delay; stars are auto."""
    panels = figure.subplots(1, 2, sharey=True)
    for axes, error in zip(panels, ("in_phase", "aligned"), strict=True):
        for marker, (predictor, curve) in zip("osv", curves.items(), strict=True):
            tried = {delay_ms: each for delay_ms, each in curve.items() if delay_ms is not None}
            errors = [getattr(each, error) for each in tried.values()]
            (line,) = axes.plot(list(tried), errors, f"{marker}-", label=predictor)
            auto = curve[None]
            star = {"markersize": 14, "color": line.get_color()}
            axes.plot(auto.delay_ms, getattr(auto, error), "*", **star)
        axes.set(title=error.replace("_", " "), yscale="log", xlabel="perceived delay E (ms)")
    panels[0].set_ylabel("NRMSE")
    figure.suptitle(link)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
