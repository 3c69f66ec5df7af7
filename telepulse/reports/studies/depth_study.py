"""Study of the sweep: modelled wrists of several arterial pressures, each swept repeatedly.

Scored are the best hold-down against the mean arterial pressure, and the agreement of the repeats.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from display_node.press.sweep import DepthSweep, SweepPlan
from display_node.scoring.depth_curve import DepthCurve
from protocol.config.quantities import count_text
from protocol.tissue import PASCALS_PER_MMHG
from sensing_node.sources.wrist import Wrist, WristScene
from telepulse.document import STYLES, Chapter, Plot, Report, Table, percent
from telepulse.parallel import sweep
from telepulse.simulation.depth_loop import sweep_wrist

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Criteria: error of the best hold-down against the mean arterial pressure, and range of the repeats
# of one figure over its mean.
MOST_ERROR, MOST_RANGE = 0.05, 0.05
# Mean pressure of the wrist's pulse above diastole, as a share of the pulse pressure; the heart
# rate changes it a little.
MEAN_SHARE: Final = 0.27
PULSE_MMHG: Final = 40.0
STEADY_NS: Final = 90_000_000_000
PLANS: Final = {"steps": SweepPlan(), "steady": SweepPlan(ramp_ns=STEADY_NS)}


@dataclass(frozen=True, slots=True)
class DepthEffort:
    """Mean arterial pressures, one modelled wrist each, and seeds, one repeat each."""

    means_mmhg: tuple[float, ...] = (70, 85, 100, 115, 130)
    seeds: tuple[int, ...] = (1, 2, 3, 4)


class DepthCase(NamedTuple):
    """One sweep of one modelled wrist."""

    plan: str
    mean_mmhg: float
    seed: int


class DepthScore(NamedTuple):
    """One sweep's result: the force of the mean arterial pressure, the curve, and the time taken.

    The wrist's own height at forces of the curve is `true_n`.
    """

    mean_n: float
    curve: DepthCurve
    true_n: Sequence[float]
    seconds: float

    @property
    def error(self) -> float:
        """Error of the best hold-down over the force of the mean arterial pressure."""
        return self.curve.best_n.value / self.mean_n - 1

    @property
    def figures(self) -> dict[str, float]:
        """Figures that repeats should agree in; NaN for a level that was not reached."""
        found = {
            name: np.nan if level is None else level.value
            for name, level in self.curve.levels().items()
        }
        return found | {"height": self.curve.largest_n.value}


def modelled_wrist(mean_mmhg: float, seed: int) -> WristScene:
    """Return a modelled wrist; its heart rate follows the pressure, repeats breathe differently."""
    rng = np.random.default_rng((seed, round(mean_mmhg)))
    diastolic_mmhg = mean_mmhg - MEAN_SHARE * PULSE_MMHG
    return WristScene.model_validate(
        {
            "kind": "wrist",
            "pulse": {
                "kind": "synthetic",
                "seed": seed,
                "heart_rate": f"{1.0 + 0.5 * (mean_mmhg - 70) / 60} Hz",
                "heart_rate_variability": 0.04,
                "respiration": 0.2,
                "respiration_rate": f"{rng.uniform(0.2, 0.33)} Hz",
            },
            "systolic": f"{(diastolic_mmhg + PULSE_MMHG) * PASCALS_PER_MMHG} Pa",
            "diastolic": f"{diastolic_mmhg * PASCALS_PER_MMHG} Pa",
            "noise": "1 mN",
        }
    )


def score_depth(case: DepthCase) -> DepthScore:
    """Sweep one modelled wrist once."""
    wrist = Wrist(modelled_wrist(case.mean_mmhg, case.seed))
    plan = PLANS[case.plan]
    run = DepthSweep(plan)
    samples = sweep_wrist(wrist, run, plan.high_n)
    curve = run.curve()
    true_n = [wrist.artery.height_n(force_n) for force_n in curve.force_n.tolist()]
    return DepthScore(wrist.artery.best_n, curve, true_n, samples * wrist.period_ns * 1e-9)


def score_depths(
    effort: DepthEffort, scheduler: str | None = None
) -> dict[tuple[str, float], list[DepthScore]]:
    """Sweep every modelled wrist repeatedly, by plan and mean pressure. Raises SweepError."""
    groups = list(product(PLANS, effort.means_mmhg))
    cases = [DepthCase(*group, seed) for group in groups for seed in effort.seeds]
    scores = iter(sweep(score_depth, cases, scheduler))
    return {group: [next(scores) for _ in effort.seeds] for group in groups}


def ranges(repeats: Sequence[DepthScore]) -> dict[str, float]:
    """Return the range of each figure over the repeats, as a share of its mean."""
    figures = [score.figures for score in repeats]
    return {
        name: float(np.ptp(values) / np.mean(values))
        for name in figures[0]
        if (values := [each[name] for each in figures])
    }


def meets(repeats: Sequence[DepthScore]) -> bool:
    """Return whether a wrist's sweeps meet the criteria; a level that is missing does not."""
    errs = max(abs(score.error) for score in repeats) <= MOST_ERROR
    return errs and all(spread <= MOST_RANGE for spread in ranges(repeats).values())


def report_depths(scores: dict[tuple[str, float], list[DepthScore]], effort: DepthEffort) -> Report:
    """Return the report of the study."""
    rows = []
    for (plan, mean_mmhg), repeats in scores.items():
        errors = [score.error for score in repeats]
        spread = {f"range, {name}": percent(value) for name, value in ranges(repeats).items()}
        rows.append(
            {
                "sweep": plan,
                "mean (mmHg)": f"{mean_mmhg:g}",
                "as force (N)": f"{np.mean([score.mean_n for score in repeats]):.2f}",
                "error of the best": _between(errors),
                **spread,
                "time (s)": f"{np.mean([score.seconds for score in repeats]):.0f}",
                "criteria": "met" if meets(repeats) else "missed",
            }
        )

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        drawn = [(mean, each[0]) for (plan, mean), each in scores.items() if plan == "steps"]
        drawn = drawn[:: max(1, len(drawn) // 4)]
        for style, (mean_mmhg, score) in zip(STYLES, drawn, strict=False):
            curve, color = score.curve, axes.plot([], [])[0].get_color()
            axes.plot(curve.force_n, 1e3 * np.array(score.true_n), ":", color=color)
            label = f"{mean_mmhg:g} mmHg"
            axes.plot(curve.force_n, 1e3 * curve.height_n, color=color, label=label)
            forces = [point.hold_down_n for point in curve.good]
            heights = [1e3 * point.height_n for point in curve.good]
            axes.plot(forces, heights, style[0], ms=4, color=color)
        axes.set(xlabel="hold-down (N)", ylabel="height of the pulse (mN)")
        figure.legend(title="mean arterial pressure", loc="outside lower center", ncols=5)

    words = (
        "No person was measured: the wrists are modelled, an artery by a tube law under a rigid"
        f" probe. Each has a pulse pressure of {PULSE_MMHG:g} mmHg; heart rates are 60 to 90 beats"
        " a minute, with 4 % of variability, breathing of 20 %, and noise of 1 mN. The"
        f" {len(effort.seeds)} repeats of a wrist differ in noise, rhythm and breathing. Error:"
        " of the best hold-down against the mean arterial pressure times the probe's area"
        f" (criterion: at most {percent(MOST_ERROR, '.0f')}). Range: from the least to the greatest"
        " of the repeats, over their mean, of the hold-down of the three levels and of the largest"
        f" height (criterion: at most {percent(MOST_RANGE, '.0f')})."
    )
    plot = Plot(
        "curves",
        "Sweeps in steps, one of each modelled wrist: its beats (marks), the fitted curve (line),"
        " and the wrist's own without breathing (dotted).",
        draw,
    )
    table = Table.of(
        "Sweeps of modelled wrists by mean arterial pressure",
        rows,
        "Steps: the force rises from level to level; steady: it rises evenly. All wrists are"
        " modelled.",
    )
    errors = [score.error for repeats in scores.values() for score in repeats]
    wrists = count_text(len({mean for _, mean in scores}), "modelled wrist")
    widest = max(value for repeats in scores.values() for value in ranges(repeats).values())
    findings = (
        f"On {wrists}, the best hold-down is {_between(errors)} off the mean arterial pressure"
        f" (criterion: at most {percent(MOST_ERROR, '.0f')}).",
        f"Repeated sweeps of one modelled wrist agree within {percent(widest)} (criterion: at most"
        f" {percent(MOST_RANGE, '.0f')}).",
        f"{sum(map(meets, scores.values()))} of {len(scores)} pairs of a modelled wrist and a kind"
        " of sweep meet both criteria. No person was measured.",
        *_missed(scores),
    )
    chapter = Chapter("Repeats", (words,), (table,), (plot,), findings)
    return Report("Sweeps of the hold-down on modelled wrists", (chapter,))


def _missed(scores: dict[tuple[str, float], list[DepthScore]]) -> tuple[str, ...]:
    """Return the finding that names the sweeps and wrists that miss a criterion, if there are."""
    missed = [f"{plan}, {mean:g} mmHg" for (plan, mean), each in scores.items() if not meets(each)]
    return (f"Missed: {'; '.join(missed)}.",) if missed else ()


def _between(errors: Sequence[float]) -> str:
    return f"{percent(min(errors), '+.1f')} to {percent(max(errors), '+.1f')}"
