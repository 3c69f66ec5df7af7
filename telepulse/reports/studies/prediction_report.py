"""The report of the study of predictors: tables, plots, and a prototype's figures as targets."""

from typing import TYPE_CHECKING, NamedTuple

from protocol.config.quantities import count_text
from telepulse.document import STYLES, Chapter, Plot, Report, Table, percent
from telepulse.reports.studies.prediction_pulses import (
    HIGH_PASS_HZ,
    LOW_PASS_HZ,
    NOISE,
    RECORDED,
    SCORED_FROM_S,
)
from telepulse.reports.studies.prediction_study import (
    COSTLY_FROM_S,
    HORIZONS_MS,
    Errors,
    PredictionEffort,
    PredictionScores,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HORIZON_COLUMNS = tuple(f"{horizon_ms} ms" for horizon_ms in HORIZONS_MS)
TICK_BOUND_US = 150.0
# A target is reached up to this share above the prototype's figure.
ALLOWANCE = 0.05
MEDIAN = "median of the sets"
# Of the three analogues, only the one with the shortest memory is reported: it has the least error
# at most horizons.
ANALOGUE = "analogue 0.05 s"


class PredictionTarget(NamedTuple):
    """The NRMSE to reach with a predictor on a set, at each horizon; None: no target.

    source: "prototype", "its oracle", which knew the next interval, or "stretch goal".
    """

    where: str
    predictor: str
    source: str
    figures: tuple[float | None, ...]
    allowance: float = ALLOWANCE


class TargetResult(NamedTuple):
    """A target beside our figures."""

    target: PredictionTarget
    ours: tuple[float, ...]

    def misses(self) -> dict[str, float]:
        """Return the share by which ours exceeds the target at each horizon where it is missed."""
        figures = zip(HORIZON_COLUMNS, self.ours, self.target.figures, strict=True)
        excess = {
            column: ours / figure - 1 for column, ours, figure in figures if figure is not None
        }
        return {column: each for column, each in excess.items() if each > self.target.allowance}


TARGETS = (
    PredictionTarget(MEDIAN, "stack", "prototype", (0.045, 0.156, 0.321, 0.394)),
    PredictionTarget(MEDIAN, ANALOGUE, "prototype", (0.070, 0.206, 0.379, 0.433)),
    PredictionTarget(MEDIAN, "fir", "prototype", (0.055, 0.207, 0.486, 0.537)),
    PredictionTarget(MEDIAN, "hold", "prototype", (0.307, 0.715, 1.21, 1.54)),
    PredictionTarget("variability", "stack", "prototype", (0.027, 0.078, 0.214, 0.295)),
    PredictionTarget("variability", "stack", "its oracle", (0.021, 0.064, 0.142, 0.167), 0.0),
    PredictionTarget("variability", "stack", "stretch goal", (None, None, 0.18, None), 0.0),
    PredictionTarget("ramp", "stack", "prototype", (0.036, 0.099, 0.192, 0.218)),
    PredictionTarget("ramp", "stack", "its oracle", (0.009, 0.025, 0.050, 0.059), 0.0),
    PredictionTarget("ramp", "stack", "stretch goal", (None, None, 0.12, None), 0.0),
    PredictionTarget("ectopic", "stack", "prototype", (0.033, 0.093, 0.254, 0.341)),
    PredictionTarget("ectopic", "stack", "its oracle", (0.021, 0.065, 0.167, 0.249), 0.0),
    PredictionTarget("fibrillation", "stack", "prototype", (0.045, 0.159, 0.505, 0.776)),
    PredictionTarget("fibrillation", "stack", "its oracle", (0.045, 0.158, 0.528, 0.787), 0.0),
)


def compare_targets(errors: dict[str, Errors], medians: Errors) -> list[TargetResult]:
    """Compare errors with the targets on these sets, and on the median if `medians` is given."""
    where = {MEDIAN: medians, **errors} if medians else errors
    return [
        TargetResult(target, where[target.where][target.predictor])
        for target in TARGETS
        if target.where in where
    ]


def report_prediction(scores: PredictionScores, effort: PredictionEffort) -> Report:
    """Return the report on scores that took this effort."""
    return Report(
        "Prediction: error against horizon and cost",
        (_errors_chapter(scores, effort), _targets_chapter(scores), _costs_chapter(scores)),
    )


def _errors_chapter(scores: PredictionScores, effort: PredictionEffort) -> Chapter:
    def table(title: str, first: str, errors: Errors) -> Table:
        rows = [(name, *(f"{error:.3f}" for error in each)) for name, each in errors.items()]
        return Table(title, (first, *HORIZON_COLUMNS), rows)

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        for style, (name, errors) in zip(STYLES, scores.medians.items(), strict=False):
            axes.plot(HORIZONS_MS, errors, style, label=name)
        axes.set(yscale="log", xlabel="horizon (ms)", ylabel=f"NRMSE, {MEDIAN}")
        figure.legend(loc="outside lower center", ncols=4, fontsize="small")

    missing = (
        f" The {len(RECORDED)} recordings are missing, so that medians are over"
        f" {len(scores.errors)} sets: pip install 'telepulse[bench]' adds heartpy, which has them,"
        " up to Python 3.11."
    )
    words = (
        f"Each of {len(scores.errors)} pulses of up to {effort.seconds:g} s at 1 kHz passes a"
        f" causal chain of {HIGH_PASS_HZ:g} to {LOW_PASS_HZ:g} Hz and gets white noise of"
        f" {percent(NOISE, '.0f')} of its standard deviation. It comes in frames of 5 ms, and a"
        " predictor has"
        " one piece of work a millisecond, as in a display. NRMSE: RMS difference from the pulse"
        f" without noise over its standard deviation, after {SCORED_FROM_S:g} s; the horizon counts"
        f" from the newest sample.{'' if set(RECORDED) <= set(scores.errors) else missing}"
    )
    by_set = {name: errors["stack"] for name, errors in scores.errors.items()}
    tables = (
        table("Median over the sets", "predictor", scores.medians),
        table("The stack, by set", "set", by_set),
    )
    plot = Plot("error-horizon", "Median NRMSE against the horizon.", draw)
    return Chapter("Errors", (words,), tables, (plot,))


def _targets_chapter(scores: PredictionScores) -> Chapter:
    results = compare_targets(scores.errors, scores.medians)
    silent = compare_targets(scores.errors_without_shape_cue, {})
    paragraphs = (
        f"{_reached(results)} of {len(results)} rows are reached. The prototype is an earlier one"
        " of this project; its pulses are not available. Our sets have the same names, but other"
        " rates, shares, noise and recordings, which alone may explain a difference of a tenth. An"
        " oracle knew the next interval of the prototype's generator, not of ours.",
        "In our source a beat's systole scales with its own interval, so its shape predicts the"
        " next beat, and a predictor can have less error than an oracle. In the second table a"
        " systole scales with the interval before, and only the rhythm predicts the next beat:"
        f" {_reached(silent)} of {len(silent)} rows are reached there.",
        "Our own oracle knows the generator: the shape of a beat, the beats until now, and the"
        " distribution of the next interval, of which it predicts the mean. It sees a beat from the"
        " given number of widths before the peak of its first wave, which is 1, 4 or 14 % of that"
        " wave's height, and 20 ms before the chain shows it.",
        "The best linear filter of the last 1.3 s that stays the same over a set has"
        f" {', '.join(f'{error:.3f}' for error in scores.best_filter)} (medians over the sets)."
        " It is fitted to all values but those that it predicts, the later ones included.",
    )
    tables = (
        _targets_table("Ours / the prototype's", results),
        _targets_table("The same where no shape predicts the next beat", silent),
        _oracle_table(scores),
    )
    at_100_ms = HORIZONS_MS.index(100)
    findings = [
        f"{_reached(results)} of {len(results)} figures of an earlier prototype of this project are"
        f" reached, and {_reached(silent)} of {len(silent)} where no shape predicts the next beat."
    ]
    if scores.medians:
        stack, hold = (scores.medians[name][at_100_ms] for name in ("stack", "hold"))
        findings.insert(
            0,
            f"NRMSE 100 ms ahead, median of {count_text(len(scores.errors), 'set')}: the stack"
            f" {stack:.3f}, holding the newest value {hold:.3f}.",
        )
        worst = max(scores.errors, key=lambda name: scores.errors[name]["stack"][at_100_ms])
        least = min(scores.errors, key=lambda name: scores.errors[name]["stack"][at_100_ms])
        findings.insert(
            1,
            f"By set, the stack's NRMSE 100 ms ahead is from"
            f" {scores.errors[least]['stack'][at_100_ms]:.3f} ({least}) to"
            f" {scores.errors[worst]['stack'][at_100_ms]:.3f} ({worst}).",
        )
    return Chapter("Beside the prototype", paragraphs, tables, findings=findings)


def _oracle_table(scores: PredictionScores) -> Table:
    rows = []
    for (name, widths), errors in scores.oracle.items():
        ours = scores.errors_without_shape_cue[name]["stack"]
        both = (f"{mine:.3f} / {best:.3f}" for mine, best in zip(ours, errors, strict=True))
        rows.append((name, f"{widths:g} widths", *both))
    return Table(
        "The stack / our oracle, where no shape predicts the next beat",
        ("set", "sees a beat from", *HORIZON_COLUMNS),
        rows,
    )


def _reached(results: list[TargetResult]) -> int:
    return sum(not result.misses() for result in results)


def _targets_table(title: str, results: list[TargetResult]) -> Table:
    rows = []
    for result in results:
        where, predictor, source, figures, _ = result.target
        cells = [
            f"{ours:.3f} / " + ("–" if figure is None else f"{figure:.3f}")
            for ours, figure in zip(result.ours, figures, strict=True)
        ]
        misses = ", ".join(
            f"{column} {percent(excess, '+.0f')}" for column, excess in result.misses().items()
        )
        verdict = f"missed: {misses}" if misses else "reached"
        rows.append((where, predictor, source, *cells, verdict))
    return Table(
        title,
        ("set", "predictor", "target", *HORIZON_COLUMNS, "verdict"),
        rows,
        "Each cell: ours / the target. Reached: at every horizon at most"
        f" {percent(ALLOWANCE, '.0f')} above the prototype, or at or below the stretch goal and"
        " the oracle.",
    )


def _costs_chapter(scores: PredictionScores) -> Chapter:
    # Of the analogues, the expert of the shortest memory is shown.
    medians = {"analogue": scores.medians[ANALOGUE]} | scores.medians
    errors = {name: medians[name][HORIZONS_MS.index(100)] for name in scores.costs}

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        for name, cost in scores.costs.items():
            axes.plot(cost.step_us, errors[name], "o")
            at = (cost.step_us, errors[name])
            axes.annotate(name, at, (6, 4), textcoords="offset points")
        axes.margins(0.15)
        axes.set(xscale="log", xlabel="processor time of 5 ms of samples (µs)")
        axes.set_ylabel("NRMSE at 100 ms")

    rows = [
        {
            "predictor": name,
            "tick p50 (µs)": f"{cost.tick_p50_us:.1f}",
            "tick p99 (µs)": f"{cost.tick_p99_us:.1f}",
            "a step (µs)": f"{cost.step_us:.1f}",
            "NRMSE at 100 ms": f"{errors[name]:.3f}",
        }
        for name, cost in scores.costs.items()
    ]
    note = "Error: median over the sets; analogue: the expert with the shortest memory."
    high_us = scores.costs["stack"].tick_p99_us
    words = (
        f"Processor time of one thread, after {COSTLY_FROM_S:g} s, at ticks of 1 ms with one piece"
        " of work and one prediction each; a step is 5 ms. The stack's 99th percentile is"
        f" {high_us:.0f} µs per tick, {'within' if high_us <= TICK_BOUND_US else 'above'} the"
        f" {TICK_BOUND_US:g} µs that it may take; a busy machine makes it more."
    )
    caption = "Median NRMSE at 100 ms against the cost of 5 ms of samples."
    table = Table.of("Cost by the predictor a scene names", rows, note)
    finding = (
        f"The 99th percentile of a tick of the stack is {high_us:.0f} µs of processor time (bound:"
        f" {TICK_BOUND_US:g} µs)."
    )
    plot = Plot("cost-error", caption, draw)
    return Chapter("Costs", (words,), (table,), (plot,), (finding,))
