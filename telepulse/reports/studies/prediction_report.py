"""The study of predictors as a report: errors, costs, and a prototype's figures as targets."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from telepulse.reports.document import Chapter, Plot, Report, Table
from telepulse.reports.studies.prediction_pulses import (
    HIGH_PASS_HZ,
    LOW_PASS_HZ,
    NOISE,
    RECORDED,
    SCORED_FROM_S,
)
from telepulse.reports.studies.prediction_scores import (
    COSTLY_FROM_S,
    HORIZONS_MS,
    Errors,
    PredictionEffort,
    PredictionScores,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# A target is reached up to this share above the prototype's figure.
ALLOWANCE = 0.05
MEDIAN = "median of the sets"
# The short memory, the best at most horizons, stands for the analogues.
ANALOGUE = "analogue 0.05 s"


@dataclass(frozen=True, slots=True)
class PredictionTarget:
    """The prototype's NRMSE of a predictor on a set, one a horizon; None: no target."""

    where: str
    predictor: str
    whose: str
    figures: tuple[float | None, ...]
    allowance: float = ALLOWANCE


@dataclass(frozen=True, slots=True)
class TargetResult:
    """A target beside our figures."""

    target: PredictionTarget
    ours: tuple[float, ...]

    def excess(self, at: int) -> float | None:
        """Return the share by which ours exceeds the target at a horizon; None without a target."""
        figure = self.target.figures[at]
        return None if figure is None else self.ours[at] / figure - 1

    @property
    def reached(self) -> bool:
        """Whether the target is reached at every horizon."""
        excesses = [self.excess(at) for at in range(len(HORIZONS_MS))]
        return all(excess is None or excess <= self.target.allowance for excess in excesses)


TARGETS = (
    PredictionTarget(MEDIAN, "stack", "prototype", (0.045, 0.156, 0.321, 0.394)),
    PredictionTarget(MEDIAN, ANALOGUE, "prototype", (0.070, 0.206, 0.379, 0.433)),
    PredictionTarget(MEDIAN, "fir", "prototype", (0.055, 0.207, 0.486, 0.537)),
    PredictionTarget(MEDIAN, "hold", "prototype", (0.307, 0.715, 1.21, 1.54)),
    PredictionTarget("variability", "stack", "prototype", (0.027, 0.078, 0.214, 0.295)),
    PredictionTarget("variability", "stack", "its oracle", (0.021, 0.064, 0.142, 0.167), 0.0),
    PredictionTarget("variability", "stack", "prize", (None, None, 0.18, None), 0.0),
    PredictionTarget("ramp", "stack", "prototype", (0.036, 0.099, 0.192, 0.218)),
    PredictionTarget("ramp", "stack", "its oracle", (0.009, 0.025, 0.050, 0.059), 0.0),
    PredictionTarget("ramp", "stack", "prize", (None, None, 0.12, None), 0.0),
    PredictionTarget("ectopic", "stack", "prototype", (0.033, 0.093, 0.254, 0.341)),
    PredictionTarget("ectopic", "stack", "its oracle", (0.021, 0.065, 0.167, 0.249), 0.0),
    PredictionTarget("fibrillation", "stack", "prototype", (0.045, 0.159, 0.505, 0.776)),
    PredictionTarget("fibrillation", "stack", "its oracle", (0.045, 0.158, 0.528, 0.787), 0.0),
)


def compare_targets(errors: dict[str, Errors], medians: Errors) -> list[TargetResult]:
    """Compare the targets on the sets with errors; without medians, none on the median."""
    where = {MEDIAN: medians, **errors} if medians else errors
    return [
        TargetResult(target, where[target.where][target.predictor])
        for target in TARGETS
        if target.where in where
    ]


TICK_BOUND_US = 150.0
HORIZON_COLUMNS = tuple(f"{horizon_ms} ms" for horizon_ms in HORIZONS_MS)
# The expert whose error is plotted for a scene's predictor of several experts.
SHOWN_AS = {"analogue": "analogue 0.05 s"}
# The horizon whose error is plotted against cost.
PLOTTED = HORIZONS_MS.index(100)
STYLES = ("o-", "s-", "x--", "^-", "v--", "P-", "D-", "*-")


def report_prediction(scores: PredictionScores, effort: PredictionEffort) -> Report:
    """Return the report on scores that took this effort."""
    return Report(
        "Prediction: error against horizon and cost",
        (_errors_chapter(scores, effort), _targets_chapter(scores), _costs_chapter(scores)),
    )


def missing_sets(scores: PredictionScores) -> str:
    """Return a sentence on the missing recordings; empty when there are none."""
    if set(RECORDED) <= set(scores.errors):
        return ""
    return (
        f" The {len(RECORDED)} recordings are missing, so that medians are over"
        f" {len(scores.errors)} sets: pip install 'telepulse[test]' brings heartpy with them."
    )


def _errors_chapter(scores: PredictionScores, effort: PredictionEffort) -> Chapter:
    return Chapter(
        "Errors",
        (
            f"Each of {len(scores.errors)} pulses of up to {effort.seconds:g} s at 1 kHz passes a"
            f" causal chain of {HIGH_PASS_HZ:g} to {LOW_PASS_HZ:g} Hz and gets white noise of"
            f" {NOISE:.0%} of its standard deviation. It comes in frames of 5 ms, and a predictor"
            " has one piece of work a millisecond, as in a display. NRMSE: RMS difference from the"
            f" pulse without noise over its standard deviation, after {SCORED_FROM_S:g} s; the"
            f" horizon counts from the newest sample.{missing_sets(scores)}",
        ),
        (
            _table("Median over the sets", "predictor", scores.medians),
            _table(
                "The stack, by set",
                "set",
                {name: errors["stack"] for name, errors in scores.errors.items()},
            ),
        ),
        (
            Plot(
                "error-horizon",
                "Median NRMSE against the horizon.",
                lambda figure: _draw_horizons(figure, scores),
            ),
        ),
    )


def _table(title: str, first: str, rows: dict[str, tuple[float, ...]]) -> Table:
    return Table(
        title,
        (first, *HORIZON_COLUMNS),
        tuple((name, *(f"{error:.3f}" for error in errors)) for name, errors in rows.items()),
    )


def _targets_chapter(scores: PredictionScores) -> Chapter:
    results = compare_targets(scores.errors, scores.medians)
    silent = compare_targets(scores.silent_errors, {})
    reached = sum(result.reached for result in results)
    return Chapter(
        "Beside the prototype",
        (
            f"{reached} of {len(results)} rows are reached. The prototype's figures were printed"
            " by its authors; its sets are not here. Ours have the same names, but rates, shares"
            " and noise within them are our choice, and the recordings are others: this alone may"
            " explain a difference of a tenth. Its oracles had its generator, not ours.",
            "In our source a beat's systole scales with its own interval: its shape predicts the"
            " next beat, so that a predictor can be below an oracle. In the second table systoles"
            " scale with the interval before, and only the rhythm predicts the next beat:"
            f" {sum(result.reached for result in silent)} of {len(silent)} rows are"
            " reached there.",
        ),
        (
            _targets_table("Ours / the prototype's", results),
            _targets_table("The same where no shape predicts the next beat", silent),
        ),
    )


def _targets_table(title: str, results: list[TargetResult]) -> Table:
    return Table(
        title,
        ("set", "predictor", "whose", *HORIZON_COLUMNS, "verdict"),
        tuple(_target_row(result) for result in results),
        f"Reached: at every horizon at most {ALLOWANCE:.0%} above the prototype, or at or below"
        " the prize and the oracle.",
    )


def _target_row(result: TargetResult) -> tuple[str, ...]:
    target = result.target
    cells, misses = [], []
    for at, (ours, figure) in enumerate(zip(result.ours, target.figures, strict=True)):
        cells.append(f"{ours:.3f} / " + ("–" if figure is None else f"{figure:.3f}"))
        excess = result.excess(at)
        if excess is not None and excess > target.allowance:
            misses.append(f"{HORIZON_COLUMNS[at]} +{excess:.0%}")
    verdict = "missed: " + ", ".join(misses) if misses else "reached"
    return (target.where, target.predictor, target.whose, *cells, verdict)


def _costs_chapter(scores: PredictionScores) -> Chapter:
    stack = scores.costs["stack"]
    within = "within" if stack.tick_p99_us <= TICK_BOUND_US else "above"
    return Chapter(
        "Costs",
        (
            f"Processor time of one thread, after {COSTLY_FROM_S:g} s, at ticks of 1 ms with one"
            " piece of work and one prediction each; a step is 5 ms. The stack's 99th"
            f" percentile is {stack.tick_p99_us:.0f} µs a tick, {within} the"
            f" {TICK_BOUND_US:g} µs that it may take; a busy machine makes it more.",
        ),
        (
            Table(
                "Cost by the predictor a scene names",
                ("predictor", "tick p50 (µs)", "tick p99 (µs)", "a step (µs)", "NRMSE at 100 ms"),
                tuple(
                    (
                        name,
                        f"{cost.tick_p50_us:.1f}",
                        f"{cost.tick_p99_us:.1f}",
                        f"{cost.step_us:.1f}",
                        f"{_plotted(scores, name):.3f}",
                    )
                    for name, cost in scores.costs.items()
                ),
                "Error: median over the sets; of the analogues the one of the shortest memory.",
            ),
        ),
        (
            Plot(
                "cost-error",
                "Median NRMSE at 100 ms against the cost of 5 ms of samples.",
                lambda figure: _draw_costs(figure, scores),
            ),
        ),
    )


def _plotted(scores: PredictionScores, name: str) -> float:
    return scores.medians[SHOWN_AS.get(name, name)][PLOTTED]


def _draw_horizons(figure: "Figure", scores: PredictionScores) -> None:
    axes = figure.add_subplot()
    for style, (name, errors) in zip(STYLES, scores.medians.items(), strict=False):
        axes.plot(HORIZONS_MS, errors, style, label=name)
    axes.set_yscale("log")
    axes.set_xlabel("horizon (ms)")
    axes.set_ylabel(f"NRMSE, {MEDIAN}")
    figure.legend(loc="outside lower center", ncols=4, fontsize="small")


def _draw_costs(figure: "Figure", scores: PredictionScores) -> None:
    axes = figure.add_subplot()
    for name, cost in scores.costs.items():
        error = _plotted(scores, name)
        axes.plot(cost.step_us, error, "o")
        axes.annotate(name, (cost.step_us, error), (6, 4), textcoords="offset points")
    axes.set_xscale("log")
    axes.margins(0.15)
    axes.set_xlabel("processor time of 5 ms of samples (µs)")
    axes.set_ylabel("NRMSE at 100 ms")
