"""What to buffer and what to predict over five links: error of the felt force at each delay.

The perceived delay E is the part of a link's delay that is buffered; the rest is predicted. Each
case runs both nodes in virtual time.
"""

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from benchmarks.benchmark import Benchmark
from benchmarks.link.policies import DELAYS_MS, run_policies
from benchmarks.link.runs import (
    LINKS,
    PREDICTORS,
    QUICK,
    TCP,
    Effort,
    LinkCase,
    LinkResult,
    pooled,
    run_link,
)
from display_node.prediction import PredictorName
from tests.support.drawn_pulses import pulses

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Of each pulse with which the policies for late samples are compared.
POLICIES_S, QUICK_POLICIES_S = 60.0, 24.0
# By predictor and perceived delay; None: chosen by the display.
Curves = dict[PredictorName, dict[float | None, LinkResult]]


def main(benchmark: Benchmark) -> None:
    """Run every case, then the policies for late samples; print the tables."""
    effort = QUICK if benchmark.quick else Effort()
    if benchmark.seeds is not None:
        effort = replace(effort, seeds=tuple(range(1, benchmark.seeds + 1)))
    results = score_links(benchmark, effort)
    _show_choices(benchmark, results)
    for number, (link, curves) in enumerate(results.items(), 1):
        _show_curves(benchmark, link, curves)
        benchmark.plot(str(number), partial(_draw, link=link, curves=curves))
    _show_policies(benchmark)


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


def _show_policies(benchmark: Benchmark) -> None:
    # heartpy's recording is included where heartpy is installed.
    names = ["variability"] if benchmark.quick else ["variability", "heartpy data"]
    seconds = QUICK_POLICIES_S if benchmark.quick else POLICIES_S
    sets = [each for each in pulses(seconds, seed=1) if each.name in names]
    found = benchmark.run(partial(run_policies, link=LINKS[TCP].text), sets)
    benchmark.table(
        f"Late samples over {TCP}: error against the pulse of E ago, as above",
        ("pulse", "late samples", "classic delay (ms)", *(f"E = {at} ms" for at in DELAYS_MS)),
        [
            (pulse.name, policy, f"{each.classic_delay_ms}", *(f"{error:.3f}" for error in errors))
            for pulse, each in zip(sets, found, strict=True)
            for policy, errors in each.errors.items()
        ],
    )


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
