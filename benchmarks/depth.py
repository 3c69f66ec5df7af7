"""Best hold-down of repeated sweeps of modelled wrists, against the mean arterial pressure.

Heart rates are 60 to 90 a minute, with 4 % of variability, breathing of 20 %, and noise of 1 mN.
The repeats of a wrist differ in noise, rhythm and breathing. No person is measured.
"""

from collections.abc import Sequence
from itertools import product
from typing import Final, NamedTuple

import numpy as np

from benchmarks.benchmark import Benchmark
from display_node.press.sweep import DepthSweep, SweepPlan
from display_node.scoring.depth_curve import DepthCurve
from protocol.tissue import PASCALS_PER_MMHG
from sensing_node.sources.wrist import Wrist, WristScene
from telepulse.simulation.simulated_run import sweep_wrist

# Mean pressure of the wrist's pulse above diastole, as a share of the pulse pressure; the heart
# rate changes it a little.
MEAN_SHARE: Final = 0.27
PULSE_MMHG: Final = 40.0
STEADY_NS: Final = 90_000_000_000
# Figures of a sweep that repeats should agree in.
LEVELS: Final = "light", "deeper", "deepest", "height"
PLANS: Final = {"steps": SweepPlan(), "steady": SweepPlan(ramp_ns=STEADY_NS)}


MEANS_MMHG, REPEATS = (70.0, 85.0, 100.0, 115.0, 130.0), 4


class DepthCase(NamedTuple):
    """One sweep of one modelled wrist."""

    plan: str
    mean_mmhg: float
    seed: int


class DepthScore(NamedTuple):
    """One sweep: the force of the mean arterial pressure, the curve found, and the time taken."""

    mean_n: float
    curve: DepthCurve
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
    return DepthScore(wrist.artery.best_n, run.curve(), samples * wrist.period_ns * 1e-9)


def main(benchmark: Benchmark) -> None:
    """Print errors and agreement by kind of sweep and wrist, and judge both."""
    means_mmhg = MEANS_MMHG[:1] if benchmark.quick else MEANS_MMHG
    seeds = range(1, 2 if benchmark.quick else 1 + (benchmark.seeds or REPEATS))
    groups = list(product(PLANS, means_mmhg))
    cases = [DepthCase(plan, mean, seed) for plan, mean in groups for seed in seeds]
    found = iter(benchmark.run(score_depth, cases))
    scores = {group: [next(found) for _ in seeds] for group in groups}
    benchmark.table(
        "Sweeps of modelled wrists by mean arterial pressure; ranges: of the repeats, over their"
        " mean",
        ("sweep", "mean, mmHg", "as force, N", "error of the best", *LEVELS, "time, s"),
        [_row(plan, mean, repeats) for (plan, mean), repeats in scores.items()],
    )
    errors = [abs(score.error) for repeats in scores.values() for score in repeats]
    benchmark.judge("error of the best hold-down", max(errors))
    widest = [spread for repeats in scores.values() for spread in ranges(repeats).values()]
    benchmark.judge("range of the repeats, over their mean", max(widest))


def _row(plan: str, mean_mmhg: float, repeats: Sequence[DepthScore]) -> tuple[str, ...]:
    errors = [100 * score.error for score in repeats]
    return (
        plan,
        f"{mean_mmhg:g}",
        f"{np.mean([score.mean_n for score in repeats]):.2f}",
        f"{min(errors):+.1f} to {max(errors):+.1f} %",
        *(f"{100 * spread:.1f} %" for spread in ranges(repeats).values()),
        f"{np.mean([score.seconds for score in repeats]):.0f}",
    )


def ranges(repeats: Sequence[DepthScore]) -> dict[str, float]:
    """Return the range of each figure over the repeats, as a share of its mean."""
    figures = [score.figures for score in repeats]
    return {
        name: float(np.ptp(values) / np.mean(values))
        for name in figures[0]
        if (values := [each[name] for each in figures])
    }
