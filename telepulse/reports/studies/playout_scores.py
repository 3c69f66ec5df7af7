"""Every playout rule on every link, at 1 % late and at its defaults, beside the optima."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

from display_node.reception.playout import LATE_TARGET, DelayEstimator
from telepulse.reports.studies.playout_links import (
    FRAME_NS,
    LINKS,
    SECONDS,
    best_constant_ms,
    best_moving,
    cheapest,
    make_trace,
)
from telepulse.reports.studies.playout_rules import (
    DelayRule,
    FixedDelay,
    MakeRule,
    MoonPercentile,
    NetEqLike,
    PlayedTrace,
    Ramjee1,
    Ramjee4,
    play,
)
from telepulse.reports.studies.sweep import sweep

MS = 1e6
FRAME_MS = FRAME_NS / MS
# Prices of a late share, in ms, for the optimum's curve.
PRICES_MS = (10.0, 30.0, 100.0, 300.0, 1_000.0, 3_000.0, 10_000.0, 30_000.0)


@dataclass(frozen=True, slots=True)
class TunedRule:
    """A rule and its one parameter, from the setting with fewest late frames to that with most."""

    name: str
    make: MakeRule
    parameter: str
    fewest: float
    most: float
    default: float


def _ours(late_target: float) -> DelayRule:
    return DelayEstimator(late_target, warp=math.inf)


def _fixed(reserve_ms: float) -> DelayRule:
    return FixedDelay(round(reserve_ms * MS))


OURS = "ours"
RULES: dict[str, TunedRule] = {
    rule.name: rule
    for rule in (
        TunedRule(OURS, _ours, "late target", 1e-4, 0.3, LATE_TARGET),
        TunedRule("Ramjee 1", Ramjee1, "β", 60.0, 0.5, 4.0),
        TunedRule("Ramjee 4", Ramjee4, "β", 60.0, 0.5, 4.0),
        TunedRule("Moon percentile", MoonPercentile, "late target", 1e-4, 0.3, 0.01),
        TunedRule("NetEQ-like", NetEqLike, "late target", 1e-4, 0.999, 0.05),
        TunedRule("fixed", _fixed, "reserve in ms", 600.0, 1.0, 40.0),
    )
}


@dataclass(frozen=True, slots=True)
class PlayoutEffort:
    """Amount of computing: settings over a parameter's whole range, then bisections."""

    seconds: float = SECONDS
    scan: int = 4
    bisections: int = 5
    links: tuple[str, ...] = tuple(LINKS)
    curves: tuple[str, ...] = ()
    late: float = LATE_TARGET


@dataclass(frozen=True, slots=True)
class RuleScore:
    """One rule on one link.

    `tuned`, at `setting`, has the least delay with at most the share late if that was `reached`,
    and otherwise the fewest late frames. `default` is at the rule's default, `warped` the same as
    the display would play it. `tried` holds every setting that was played, by its late share.
    """

    tuned: PlayedTrace
    setting: float
    reached: bool
    default: PlayedTrace
    warped: PlayedTrace
    tried: tuple[PlayedTrace, ...]


@dataclass(frozen=True, slots=True)
class LinkScore:
    """A link's smallest delay and both optima in ms, from the whole trace.

    moving_ms is a bound, found_ms the mean of the path that was found. `curve` holds the moving
    optimum at several prices of lateness.
    """

    smallest_ms: float
    constant_ms: float
    moving_ms: float
    found_ms: float
    curve: tuple[PlayedTrace, ...]


@dataclass(frozen=True, slots=True)
class PlayoutScores:
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
    links = sweep(partial(score_link, effort=effort), effort.links, scheduler)
    rules: dict[str, dict[str, RuleScore]] = {link: {} for link in effort.links}
    for case, score in zip(
        cases, sweep(partial(score_rule, effort=effort), cases, scheduler), strict=True
    ):
        rules[case.link][case.rule] = score
    return PlayoutScores(dict(zip(effort.links, links, strict=True)), rules)


def score_link(link: str, effort: PlayoutEffort) -> LinkScore:
    """Compute the optima of a link."""
    delay_ms = make_trace(link, effort.seconds).delay_ns / MS
    optimum = best_moving(delay_ms, effort.late, FRAME_MS)
    prices_ms = PRICES_MS if link in effort.curves else ()
    paths = (cheapest(delay_ms, price_ms, FRAME_MS) for price_ms in prices_ms)
    return LinkScore(
        float(delay_ms.min()),
        best_constant_ms(delay_ms, effort.late),
        optimum.bound_ms,
        optimum.best.delay_ms,
        (
            PlayedTrace(optimum.bound_ms, effort.late),
            *(PlayedTrace(path.delay_ms, path.late) for path in paths),
        ),
    )


def score_rule(case: RuleOnLink, effort: PlayoutEffort) -> RuleScore:
    """Tune a rule on a link, and play it at its default."""
    rule, trace = RULES[case.rule], make_trace(case.link, effort.seconds)

    def at(setting: float) -> PlayedTrace:
        return play(rule.make(setting), trace)

    tried = _search(at, rule, effort)
    within = {setting: played for setting, played in tried.items() if played.late <= effort.late}
    if within:
        setting = min(within, key=lambda one: within[one].delay_ms)
    else:
        setting = min(tried, key=lambda one: tried[one].late)
    # Our estimator gets the display's slew limit; the others have no such parameter.
    follower = DelayEstimator(rule.default) if case.rule == OURS else rule.make(rule.default)
    return RuleScore(
        tuned=tried[setting],
        setting=setting,
        reached=bool(within),
        default=at(rule.default),
        warped=play(follower, trace, warped=True),
        tried=tuple(sorted(tried.values(), key=lambda played: played.late)),
    )


def _search(
    at: Callable[[float], PlayedTrace], rule: TunedRule, effort: PlayoutEffort
) -> dict[float, PlayedTrace]:
    """Try settings evenly over the parameter's logarithm, then bisect to the permitted share."""
    few, many = math.log(rule.fewest), math.log(rule.most)
    scanned = [few + (many - few) * step / (effort.scan - 1) for step in range(effort.scan)]
    tried = {math.exp(one): at(math.exp(one)) for one in scanned}
    over = [one for one in scanned if tried[math.exp(one)].late > effort.late]
    if not over or over[0] == few:
        return tried
    many, few = over[0], scanned[scanned.index(over[0]) - 1]
    for _ in range(effort.bisections):
        middle = (few + many) / 2
        played = tried[math.exp(middle)] = at(math.exp(middle))
        if played.late <= effort.late:
            few = middle
        else:
            many = middle
    return tried
