"""Mean delay and late frames of our playout delay, beside published rules and two offline optima.

Each rule gets the same delays, and is tuned for the least mean delay within the permitted late
share. Both optima are computed from the whole trace.
"""

import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from benchmarks.benchmark import Benchmark
from benchmarks.criteria import CRITERIA
from benchmarks.playout import links
from benchmarks.playout.rules import (
    FixedDelay,
    MakeRule,
    MoonPercentile,
    NetEqLike,
    PlayedTrace,
    Ramjee1,
    Ramjee4,
    play,
)
from display_node.reception.playout import LATE_TARGET, DelayEstimator

MS = 1e6


class TunedRule(NamedTuple):
    """A rule and its one parameter, from the setting with fewest late frames to that with most."""

    make: MakeRule
    fewest: float
    most: float
    default: float


OURS = "ours"
RULES: dict[str, TunedRule] = {
    OURS: TunedRule(partial(DelayEstimator, max_slew=math.inf), 1e-4, 0.3, LATE_TARGET),
    "Ramjee 1": TunedRule(Ramjee1, 60.0, 0.5, 4.0),
    "Ramjee 4": TunedRule(Ramjee4, 60.0, 0.5, 4.0),
    "Moon percentile": TunedRule(MoonPercentile, 1e-4, 0.3, 0.01),
    "NetEQ-like": TunedRule(NetEqLike, 1e-4, 0.999, 0.05),
    "fixed": TunedRule(lambda reserve_ms: FixedDelay(round(reserve_ms * MS)), 600.0, 1.0, 40.0),
}
CONSTANT, MOVING = "best constant", "best moving, 5 %"


@dataclass(frozen=True, slots=True)
class Effort:
    """Amount of computing.

    scan: settings tried over a parameter's whole range; bisections: further ones after them.
    """

    seconds: float = links.SECONDS
    scan: int = 4
    bisections: int = 5


QUICK = Effort(seconds=5.0, scan=2, bisections=1)


class RuleScore(NamedTuple):
    """One rule on one link.

    `tuned` has the least delay within the permitted late share if that was `reached`, and
    otherwise the fewest late frames. `default` is the rule's default setting, `warped` the same
    with the display's slew limit. `tried` holds every setting, in order of its late share.
    """

    tuned: PlayedTrace
    reached: bool
    default: PlayedTrace
    warped: PlayedTrace
    tried: tuple[PlayedTrace, ...]


class LinkScore(NamedTuple):
    """A link's smallest delay and both optima in ms, from the whole trace.

    optima_ms[MOVING] is a lower bound of the moving optimum, found_ms the mean delay of the best
    path that was found.
    """

    smallest_ms: float
    optima_ms: dict[str, float]
    found_ms: float


class RuleOnLink(NamedTuple):
    """A case: the name of a rule and of a link."""

    rule: str
    link: str

    def __str__(self) -> str:
        return f"{self.rule} on {self.link}"


Rules = dict[str, dict[str, RuleScore]]


def main(benchmark: Benchmark) -> None:
    """Play every rule on every link, print the tables, and judge ours by the optima."""
    effort, names = QUICK if benchmark.quick else Effort(), list(links.LINKS)
    found = benchmark.run(partial(score_link, effort=effort), names)
    cases = [RuleOnLink(rule, link) for link in names for rule in RULES]
    played = iter(benchmark.run(partial(score_rule, effort=effort), cases))
    optima = dict(zip(names, found, strict=True))
    rules: Rules = {link: {rule: next(played) for rule in RULES} for link in names}
    _show_tuned(benchmark, optima, rules)
    _show_ratios(benchmark, optima, rules)
    for way, title in (("default", "free to change at once"), ("warped", "slew of at most 5 %")):
        _show_defaults(benchmark, rules, way, title)


def score_link(link: str, effort: Effort) -> LinkScore:
    """Compute the optima of a link."""
    delay_ms = links.make_trace(link, effort.seconds).delay_ns / MS
    optimum = links.best_moving(delay_ms, LATE_TARGET)
    return LinkScore(
        float(delay_ms.min()),
        {CONSTANT: links.best_constant_ms(delay_ms, LATE_TARGET), MOVING: optimum.bound_ms},
        optimum.best.mean_ms,
    )


def score_rule(case: RuleOnLink, effort: Effort, permitted_late: float = LATE_TARGET) -> RuleScore:
    """Tune a rule on a link, and play it at its default.

    Settings are tried evenly over the parameter's logarithm, then by bisection towards the
    permitted late share.
    """
    rule, trace = RULES[case.rule], links.make_trace(case.link, effort.seconds)
    few, many = math.log(rule.fewest), math.log(rule.most)
    scanned = [few + (many - few) * step / (effort.scan - 1) for step in range(effort.scan)]
    tried = [play(rule.make(math.exp(setting)), trace) for setting in scanned]
    over = [number for number, played in enumerate(tried) if played.late > permitted_late]
    if over and over[0] > 0:
        few, many = scanned[over[0] - 1], scanned[over[0]]
        for _ in range(effort.bisections):
            middle = (few + many) / 2
            tried.append(play(rule.make(math.exp(middle)), trace))
            if tried[-1].late <= permitted_late:
                few = middle
            else:
                many = middle
    tried.sort(key=lambda played: played.late)
    within = [played for played in tried if played.late <= permitted_late]
    tuned = min(within, key=lambda played: played.delay_ms) if within else tried[0]
    # Our estimator gets the display's slew limit; the others have no such parameter.
    follower = DelayEstimator(rule.default) if case.rule == OURS else rule.make(rule.default)
    return RuleScore(
        tuned=tuned,
        reached=bool(within),
        default=play(rule.make(rule.default), trace),
        warped=play(follower, trace, warped=True),
        tried=tuple(tried),
    )


def _show_tuned(benchmark: Benchmark, optima: dict[str, LinkScore], rules: Rules) -> None:
    def over_moving(delay_ms: float, link: str) -> str:
        return f"{delay_ms:.1f} ({delay_ms / optima[link].optima_ms[MOVING]:.2f})"

    def tuned(rule: str, link: str) -> str:
        score = rules[link][rule]
        missed = "" if score.reached else f" at {100 * score.tuned.late:.1f} %"
        return over_moving(score.tuned.delay_ms, link) + missed

    rows = [
        (name, *(over_moving(score.optima_ms[name], link) for link, score in optima.items()))
        for name in (CONSTANT, MOVING)
    ]
    rows += [(rule, *(tuned(rule, link) for link in optima)) for rule in RULES]
    gap = max(each.found_ms / each.optima_ms[MOVING] - 1 for each in optima.values())
    benchmark.table(
        f"Mean delay in ms at {100 * LATE_TARGET:g} % late, delay free to change at once",
        ("rule", *optima),
        rows,
        "In parentheses over the best moving delay, which is a lower bound; paths at most"
        f" {100 * gap:.1f} % above it were found. The late share is shown where no setting is"
        " within the permitted one.",
    )


def _show_ratios(benchmark: Benchmark, optima: dict[str, LinkScore], rules: Rules) -> None:
    """Show our delay over each optimum, and judge it where there is a criterion."""
    judged, rows = {criterion.name for criterion in CRITERIA["playout"]}, []
    for link, score in optima.items():
        ours_ms, least_ms = rules[link][OURS].tuned.delay_ms, score.smallest_ms
        cells = []
        for optimum, optimum_ms in score.optima_ms.items():
            above = (ours_ms - least_ms) / (optimum_ms - least_ms)
            cells += [f"{ours_ms / optimum_ms:.3f}", f"{above:.3f}"]
            if f"{link} / {optimum}" in judged:
                benchmark.judge(f"{link} / {optimum}", ours_ms / optimum_ms)
        rows.append((link, *cells))
    benchmark.table(
        "Our mean delay over the optima",
        ("link", CONSTANT, "without smallest", MOVING, "without smallest"),
        rows,
        "Without smallest: after subtracting the trace's smallest delay, which no rule can avoid.",
    )


def _show_defaults(benchmark: Benchmark, rules: Rules, way: str, title: str) -> None:
    rows = []
    for rule in RULES:
        played: list[PlayedTrace] = [getattr(scores[rule], way) for scores in rules.values()]
        rows.append((rule, *(f"{each.delay_ms:.1f} / {100 * each.late:.1f}" for each in played)))
    title = f"Mean delay in ms / late frames in % at the defaults, {title}"
    benchmark.table(title, ("rule", *rules), rows)
