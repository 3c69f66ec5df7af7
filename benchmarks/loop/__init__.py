"""The local force loop: cost of a tick against error for ways to step it, and hard cases.

Errors are against a solution of the continuous loop; costs are processor time.
"""

import math

from benchmarks.benchmark import Benchmark
from benchmarks.loop import hard_cases, stepping
from benchmarks.loop.stepping import Errors, Score
from telepulse.parallel import in_one_thread


def main(benchmark: Benchmark) -> None:
    """Print both tables, and judge."""
    benchmark.run_parts({"stepping": stepping_table, "hard cases": hard_cases_table})


def stepping_table(benchmark: Benchmark) -> None:
    """Print the cost and the errors of each way to step a loop, by scene."""
    names = stepping.SCENES[:1] if benchmark.quick else stepping.SCENES
    found = [in_one_thread(stepping.score, name) for name in names]
    benchmark.table(
        "Cost of a tick, and error by the tick: catching up from first touch / following the pulse",
        (
            *("scene", "way to step", "p50, µs", "p99, µs"),
            *(f"{1e3 * tick_s:g} ms" for tick_s in stepping.TICKS_S),
        ),
        [_row(score) for scores, _ in found for score in scores],
        "Cost: processor time at a tick of 1 ms. Error: RMS difference of the force, over the"
        " pulse's peak to peak.",
    )
    benchmark.judge("change of the reference on halving its step", max(each for _, each in found))
    own = [score.errors for scores, _ in found for score in scores if score.way == stepping.SHIPPED]
    benchmark.judge(
        "error of the display's own way at 1 ms, following the pulse",
        max(each.following if (each := errors[stepping.USUAL_S]) else math.inf for errors in own),
    )


def _row(score: Score) -> tuple[str, ...]:
    figures = f"{score.p50_us:.3g}", f"{score.p99_us:.3g}", *map(_cell, score.errors.values())
    return score.scene, score.way, *figures


def _cell(errors: Errors | None) -> str:
    if errors is None or math.isinf(errors.following):
        return "refused" if errors is None else "unstable"
    return f"{errors.catching_up:.1e} / {errors.following:.1e}"


def hard_cases_table(benchmark: Benchmark) -> None:
    """Print the verdict of each hard case, by scene, and the figure that decides it."""
    names = stepping.SCENES[:1] if benchmark.quick else stepping.SCENES
    outcomes = {
        name: {label: hard_cases.play(name, case) for label, case in hard_cases.cases(name).items()}
        for name in names
    }
    labels = dict.fromkeys(label for each in outcomes.values() for label in each)
    benchmark.table(
        "Hard cases by scene: verdict, and the figure that decides it",
        ("case", *names),
        [(label, *(str(outcomes[name].get(label, "–")) for name in names)) for label in labels],
    )
    benchmark.judge(
        "hard cases that are unbounded",
        sum(
            outcome.verdict == hard_cases.UNBOUNDED
            for each in outcomes.values()
            for outcome in each.values()
        ),
    )
