"""Scores of the study of playout: every rule on every link, beside the optima."""

import math
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from display_node.reception.playout import LATE_TARGET, DelayEstimator
from telepulse.parallel import sweep
from telepulse.reports.studies import playout_links as links
from telepulse.reports.studies.playout_rules import (
    FixedDelay,
    MakeRule,
    MoonPercentile,
    NetEqLike,
    PlayedTrace,
    Ramjee1,
    Ramjee4,
    play,
)

MS = 1e6
# Weights of lateness in the optimum's cost: ms of mean delay per unit of late share.
PRICES_MS = (10.0, 30.0, 100.0, 300.0, 1_000.0, 3_000.0, 10_000.0, 30_000.0)


class TunedRule(NamedTuple):
    """A rule and its one parameter, from the setting with fewest late frames to that with most."""

    make: MakeRule
    parameter: str
    fewest: float
    most: float
    default: float


OURS = "ours"
RULES: dict[str, TunedRule] = {
    OURS: TunedRule(
        partial(DelayEstimator, max_slew=math.inf), "late target", 1e-4, 0.3, LATE_TARGET
    ),
    "Ramjee 1": TunedRule(Ramjee1, "β", 60.0, 0.5, 4.0),
    "Ramjee 4": TunedRule(Ramjee4, "β", 60.0, 0.5, 4.0),
    "Moon percentile": TunedRule(MoonPercentile, "late target", 1e-4, 0.3, 0.01),
    "NetEQ-like": TunedRule(NetEqLike, "late target", 1e-4, 0.999, 0.05),
    "fixed": TunedRule(
        lambda reserve_ms: FixedDelay(round(reserve_ms * MS)), "reserve in ms", 600.0, 1.0, 40.0
    ),
}
CONSTANT, MOVING = "best constant", "best moving, 5 %"
# Greatest permitted ratio of our mean delay to the optimum's, both at 1 % late.
TARGETS = (
    (links.GAUSSIAN, CONSTANT, 1.05),
    (links.SPIKES, CONSTANT, 1.05),
    (links.GAUSSIAN, MOVING, 1.15),
    (links.ROUTE, MOVING, 1.15),
    (links.FAST, MOVING, 1.15),
    (links.SLOW, MOVING, 1.15),
    (links.BURSTS, MOVING, 1.2),
    (links.RANDOM, MOVING, 1.6),
    (links.TCP, MOVING, 1.7),
)
CURVES = (links.GAUSSIAN, links.BURSTS, links.TCP)


@dataclass(frozen=True, slots=True)
class PlayoutEffort:
    """Amount of computing.

    scan: settings tried over a parameter's whole range; bisections: further ones after them.
    permitted_late: share of late frames for which rules and optima are tuned.
    """

    seconds: float = links.SECONDS
    scan: int = 4
    bisections: int = 5
    links: tuple[str, ...] = tuple(links.LINKS)
    curves: tuple[str, ...] = ()
    permitted_late: float = LATE_TARGET


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
    path that was found. `curve` holds the moving optimum for several weights of lateness.
    """

    smallest_ms: float
    optima_ms: dict[str, float]
    found_ms: float
    curve: tuple[PlayedTrace, ...]


class PlayoutScores(NamedTuple):
    """Scores of the links, and of the rules by link and name."""

    links: dict[str, LinkScore]
    rules: dict[str, dict[str, RuleScore]]


class RuleOnLink(NamedTuple):
    """A case: the name of a rule and of a link."""

    rule: str
    link: str

    def __str__(self) -> str:
        return f"{self.rule} on {self.link}"


def score_playout(effort: PlayoutEffort, scheduler: str | None = None) -> PlayoutScores:
    """Play every rule on every link, on all cores or a Dask cluster; deterministic.

    Raises SweepError.
    """
    cases = [RuleOnLink(name, link) for link in effort.links for name in RULES]
    found = sweep(partial(score_link, effort=effort), effort.links, scheduler)
    played = iter(sweep(partial(score_rule, effort=effort), cases, scheduler))
    rules = {link: {name: next(played) for name in RULES} for link in effort.links}
    return PlayoutScores(dict(zip(effort.links, found, strict=True)), rules)


def score_link(link: str, effort: PlayoutEffort) -> LinkScore:
    """Compute the optima of a link."""
    delay_ms = links.make_trace(link, effort.seconds).delay_ns / MS
    optimum = links.best_moving(delay_ms, effort.permitted_late)
    prices_ms = PRICES_MS if link in effort.curves else ()
    paths = [links.cheapest(delay_ms, price_ms) for price_ms in prices_ms]
    curve = [PlayedTrace(path.mean_ms, path.late) for path in paths]
    return LinkScore(
        float(delay_ms.min()),
        {
            CONSTANT: links.best_constant_ms(delay_ms, effort.permitted_late),
            MOVING: optimum.bound_ms,
        },
        optimum.best.mean_ms,
        (PlayedTrace(optimum.bound_ms, effort.permitted_late), *curve),
    )


def score_rule(case: RuleOnLink, effort: PlayoutEffort) -> RuleScore:
    """Tune a rule on a link, and play it at its default.

    Settings are tried evenly over the parameter's logarithm, then by bisection towards the
    permitted late share.
    """
    rule, trace = RULES[case.rule], links.make_trace(case.link, effort.seconds)
    few, many = math.log(rule.fewest), math.log(rule.most)
    scanned = [few + (many - few) * step / (effort.scan - 1) for step in range(effort.scan)]
    tried = [play(rule.make(math.exp(setting)), trace) for setting in scanned]
    over = [number for number, played in enumerate(tried) if played.late > effort.permitted_late]
    if over and over[0] > 0:
        few, many = scanned[over[0] - 1], scanned[over[0]]
        for _ in range(effort.bisections):
            middle = (few + many) / 2
            tried.append(play(rule.make(math.exp(middle)), trace))
            if tried[-1].late <= effort.permitted_late:
                few = middle
            else:
                many = middle
    tried.sort(key=lambda played: played.late)
    within = [played for played in tried if played.late <= effort.permitted_late]
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


def compare_targets(scores: PlayoutScores) -> list[tuple[str, str, float, float]]:
    """Return link, optimum, target and our ratio of mean delays, for each link that was played."""
    return [
        (link, optimum, target, ratio_to_optimum(scores, link, optimum))
        for link, optimum, target in TARGETS
        if link in scores.links
    ]


def ratio_to_optimum(
    scores: PlayoutScores, link: str, optimum: str, least_ms: float = 0.0
) -> float:
    """Return our mean delay over the optimum's, after subtracting `least_ms` from both."""
    ours_ms = scores.rules[link][OURS].tuned.delay_ms
    return (ours_ms - least_ms) / (scores.links[link].optima_ms[optimum] - least_ms)
