"""The plots of `telepulse experiment`."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from telepulse.document import Plot
from telepulse.experiment.log import SessionResults, TrialOutcome, share_close, share_correct
from telepulse.experiment.psychometrics import CHANCE, PAPER, Threshold, mean_of, proportion_correct

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Groups = Sequence[tuple[str, list[TrialOutcome]]]
GUESSING: dict[str, Any] = {"color": "C1", "linestyle": "--", "linewidth": 1.2}


def _name_rows(axes: "Axes", names: Sequence[str], margin: float = 0.5) -> None:
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - margin, margin - 1)
    axes.grid(axis="y", visible=False)


def shares(results: SessionResults) -> Plot:
    """Plot the share of right answers by condition."""

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        groups = [(name, share_correct(found)) for name, found in results.by_condition()]
        groups.append(("all of them", share_correct(results.tested)))
        groups.append(("the paper's\nsix subjects", PAPER))
        for row, (_, found) in enumerate(groups):
            low, high = found.interval
            off = [[100 * (found.share - low)], [100 * (high - found.share)]]
            colour, mark = ("C2", "s") if found is PAPER else ("C0", "o")
            axes.errorbar(100 * found.share, row, xerr=off, fmt=mark, color=colour, capsize=4)
        _name_rows(axes, [name for name, _ in groups])
        axes.axvline(100 * CHANCE, **GUESSING)
        axes.set(xlabel="% right, with the exact 95 % interval;\ndashed: guessing", xlim=(0, 102))

    return Plot(
        "experiment-shares",
        "Share of trials in which X was identified. The lowest row has the paper's four of six"
        " subjects, who were asked whether it was close to a direct touch.",
        draw,
    )


def psychometric(results: SessionResults, threshold: Threshold | None) -> Plot:
    """Plot the share of right answers against the measured difference in force error."""

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        largest = 0.0
        for name, outcomes in results.by_condition():
            apart = [abs(o.errors.a - o.errors.b) for o in outcomes]
            share, found = float(np.nanmean(apart)), share_correct(outcomes)
            low, high = found.interval
            largest = max(largest, share)
            off = [[100 * (found.share - low)], [100 * (high - found.share)]]
            axes.errorbar(100 * share, 100 * found.share, yerr=off, fmt="o", capsize=4, label=name)
        if threshold is not None and threshold.low > 0 and math.isfinite(threshold.high):
            at = np.linspace(0, 1.15 * largest, 200)
            curve = [100 * proportion_correct(x / threshold.value) for x in at]
            axes.plot(100 * at, curve, color="C4", label="fitted observer", zorder=0)
        axes.axhline(100 * CHANCE, **GUESSING)
        axes.set(ylim=(0, 104), ylabel="% right")
        axes.set_xlim(left=-2 * largest)
        axes.set_xlabel("difference of the aligned force error,\n% of the pulse from peak to peak")
        figure.legend(loc="outside lower center", ncols=2, fontsize="small")

    return Plot(
        "experiment-psychometric",
        "Share of right answers against the difference in force error between the intervals over"
        " the link and the direct ones, one point for each condition; and the best-fitting"
        " differencing observer.",
        draw,
    )


def ratings(groups: Groups) -> Plot:
    """Plot every rating by condition, and their means."""

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        for row, (_, outcomes) in enumerate(groups):
            counts = np.bincount([o.rating for o in outcomes], minlength=6)[1:]
            for rating, count in enumerate(counts, 1):
                if count:
                    area = 900 * count / len(outcomes)
                    axes.scatter(rating, row, s=area, color="C0", alpha=0.45, linewidth=0)
            mean = mean_of([o.rating for o in outcomes])
            off = [[mean.value - mean.low], [mean.high - mean.value]]
            axes.errorbar(mean.value, row, xerr=off, fmt="D", color="C1", capsize=4)
        names = [f"{name}\n{100 * share_close(found).share:.0f} % close" for name, found in groups]
        _name_rows(axes, names, 0.4)
        axes.set_xlim(0.6, 5.4)
        axes.set_xticks(range(1, 6), ["1 nothing\nlike it", "2", "3", "4 close", "5 the same"])

    return Plot(
        "experiment-ratings",
        "How close X was to the direct touch. A disc's area is the share of that rating; the"
        " diamond is the mean with its bootstrap interval.",
        draw,
    )


def course(results: SessionResults) -> Plot:
    """Plot answers and response times in the order of the trials."""

    def draw(figure: "Figure") -> None:
        timed = any(o.answered.response_s is not None for o in results.outcomes)
        panels = figure.subplots(1 + timed, 1, sharex=True, squeeze=False)[:, 0]
        above = panels[0]
        for subject in results.subjects:
            mine = [o for o in results.outcomes if o.subject == subject]
            tested = [o for o in mine if o.trial.condition is not None]
            at = [o.answered.index + 1 for o in tested]
            if results.kind == "abx":
                right = np.cumsum([o.correct for o in tested]) / np.arange(1, len(tested) + 1)
                above.plot(at, 100 * right, label=subject)
            else:
                above.plot(at, [o.rating for o in tested], "o-", markersize=4, label=subject)
            if timed:
                times = [(o.answered.index + 1, o.answered.response_s or np.nan) for o in mine]
                panels[1].plot(*zip(*times, strict=True), "o", markersize=4)
        if results.kind == "abx":
            above.axhline(100 * CHANCE, **GUESSING)
            above.set_ylim(0, 104)
        above.set_ylabel("% right so far" if results.kind == "abx" else "rating")
        if timed:
            panels[1].set_ylabel("s to the answer")
            panels[1].set_ylim(bottom=0)
        panels[-1].set_xlabel("trial")
        panels[-1].xaxis.get_major_locator().set_params(integer=True)
        if len(results.subjects) > 1:
            figure.legend(loc="outside lower center", ncols=3, fontsize="small")

    return Plot(
        "experiment-course",
        "In the order of the trials: the share of right answers so far, or the ratings; and, for a"
        " person, the time to each answer.",
        draw,
    )


def errors(results: SessionResults) -> Plot:
    """Plot the aligned force error of each interval."""

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        spread = np.random.default_rng(0)
        ways = ((False, "direct", "C0", "o"), (True, "over the link", "C1", "^"))
        for row, (_, outcomes) in enumerate(results.by_condition()):
            for on_link, what, colour, mark in ways:
                played = [p for o in outcomes for p in o.answered.played if p.on_link is on_link]
                milli = [1e3 * p.aligned_n for p in played if p.aligned_n is not None]
                at = row + (0.15 if on_link else -0.15) + spread.uniform(-0.08, 0.08, len(milli))
                label = None if row else what
                axes.plot(milli, at, mark, color=colour, markersize=5, alpha=0.7, label=label)
        _name_rows(axes, [name for name, _ in results.by_condition()])
        axes.set(xscale="log", xlabel="aligned force RMSE of an interval (mN)")
        figure.legend(loc="outside lower center", ncols=2, fontsize="small")

    return Plot("experiment-errors", "Aligned force error of every interval that was felt.", draw)
