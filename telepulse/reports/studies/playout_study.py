"""The study of playout: every rule on every link, beside the optima.

It reports mean delays at 1 % late, targets, rules at their defaults, and curves of delay against
the late share.
"""

import math
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from display_node.reception.playout import LATE_TARGET, DelayEstimator
from telepulse.reports.document import STYLES, Chapter, Plot, Report, Table, text_colour
from telepulse.reports.notation import percent
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
from telepulse.reports.studies.sweep import sweep

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
UNCOVERED = tuple(link for link in links.LINKS if link not in {each for each, *_ in TARGETS})
# In two tables, for a terminal's width.
GROUPS = {
    "steady": (links.GAUSSIAN, links.SPIKES, links.ROUTE, links.FAST, links.SLOW),
    "unsteady": (links.BURSTS, links.RANDOM, links.TCP, links.SHORT_BURSTS, links.DENSE),
}
CURVES = (links.GAUSSIAN, links.BURSTS, links.TCP)
# Sources of the published rules, by their numbers in the text.
REFERENCES = (
    "[1] R. Ramjee, J. Kurose, D. Towsley, H. Schulzrinne, “Adaptive playout mechanisms for"
    " packetized audio applications in wide-area networks”, IEEE INFOCOM 1994: algorithm 1"
    " (mean + β · mean deviation) and algorithm 4 (the same with a spike mode).",
    "[2] S. B. Moon, J. Kurose, D. Towsley, “Packet audio playout delay adjustment: performance"
    " bounds and algorithms”, Multimedia Systems 6 (1998): a percentile of the last 10 000 delays,"
    " with a spike mode.",
    "[3] The WebRTC project, NetEQ, modules/audio_coding/neteq (2023): its delay manager with its"
    " defaults, without the limits on reordering and on the number of packets.",
)
CITED = "Ramjee 1 and 4 [1], Moon percentile [2], NetEQ-like [3]"


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


def report_playout(scores: PlayoutScores, effort: PlayoutEffort) -> Report:
    """Return the report on scores that took this effort."""
    drawn = [link for link, score in scores.links.items() if len(score.curve) > 1]
    plots = [
        Plot(
            f"playout-{number}",
            f"{link}: mean delay against the late share, one point for each setting of a"
            " rule. Lower left is better. The line without marks is the best moving delay.",
            partial(_draw, scores=scores, link=link),
        )
        for number, link in enumerate(drawn, 1)
    ]
    curves = Chapter("Delay against the late share", plots=plots)
    chapters = (
        _frontier_chapter(scores, effort),
        _default_chapter(scores),
        curves,
        Chapter("References", REFERENCES),
    )
    return Report("Playout: delay against late frames", chapters)


def compare_targets(scores: PlayoutScores) -> list[tuple[str, str, float, float]]:
    """Return link, optimum, target and our ratio of mean delays, for each link that was played."""
    return [
        (link, optimum, target, _ratio(scores, link, optimum))
        for link, optimum, target in TARGETS
        if link in scores.links
    ]


def _ratio(scores: PlayoutScores, link: str, optimum: str, least_ms: float = 0.0) -> float:
    """Return our mean delay over the optimum's, after subtracting `least_ms` from both."""
    ours_ms = scores.rules[link][OURS].tuned.delay_ms
    return (ours_ms - least_ms) / (scores.links[link].optima_ms[optimum] - least_ms)


def _frontier_chapter(scores: PlayoutScores, effort: PlayoutEffort) -> Chapter:
    def against(delay_ms: float, link: str) -> str:
        return f"{delay_ms:.1f} ({delay_ms / scores.links[link].optima_ms[MOVING]:.2f})"

    def best(optimum: str, link: str) -> str:
        return against(scores.links[link].optima_ms[optimum], link)

    def tuned(rule: str, link: str) -> str:
        score = scores.rules[link][rule]
        missed = "" if score.reached else f" at {percent(score.tuned.late)}"
        return against(score.tuned.delay_ms, link) + missed

    gaps = [score.found_ms / score.optima_ms[MOVING] - 1 for score in scores.links.values()]
    paragraphs = (
        f"Each link is a trace of {effort.seconds:g} s with a frame every 5 ms; every rule"
        " gets the same delays. Each instant is played once, as soon as its age reaches the"
        " delay then in use. A delay that grows because a frame came late therefore cannot save"
        " that frame. Here a delay may change at once, as in the published rules. Each rule's"
        " own parameter is set for the least mean delay within the permitted late share.",
        "Both optima are computed from the whole trace. The moving one may change by at most"
        " 50 ms per second; its row is a lower bound of the mean delay of every such course (the"
        f" best courses found are at most {percent(max(gaps))} above it).",
        f"Published rules beside ours: {CITED}. “Fixed” is the first frame's delay plus a"
        " constant.",
    )
    rows = {optimum: partial(best, optimum) for optimum in (CONSTANT, MOVING)}
    rows |= {name: partial(tuned, name) for name in RULES}
    title = "Mean delay in ms (ratio to the best moving delay)"
    note = (
        "Tuned to the permitted late share. Where no setting is within it, the one with the least"
        " late share is shown, with that share after the delay."
    )
    tables = (*_tables(title, scores.links, rows, note), _targets_table(scores))
    title = f"At {percent(effort.permitted_late, '.0f')} late"
    return Chapter(title, paragraphs, tables, findings=_findings(scores, effort))


def _findings(scores: PlayoutScores, effort: PlayoutEffort) -> list[str]:
    """Return the verdict on the targets, and how far ours is from the optimum on each link."""
    judged = compare_targets(scores)
    missed = [f"{link} / {optimum}" for link, optimum, target, ratio in judged if ratio > target]
    verdict = f"All {len(judged)} targets are met"
    if missed:
        met = len(judged) - len(missed)
        verdict = f"{met} of {len(judged)} targets are met; missed: {'; '.join(missed)}"
    ratios = {link: _ratio(scores, link, MOVING) for link in scores.links}
    covered = [ratios[link] for link in dict.fromkeys(link for link, *_ in judged)]
    late = percent(effort.permitted_late, ".0f")
    findings = []
    if covered:
        findings.append(
            f"{verdict}: at {late} late, the mean delay of our estimator is {min(covered):.2f} to"
            f" {max(covered):.2f} times the best moving delay over {len(covered)} of"
            f" {len(ratios)} links."
        )
    for link in (each for each in UNCOVERED if each in ratios):
        rules = {rule: score.tuned.delay_ms for rule, score in scores.rules[link].items()}
        best = min(rules, key=lambda rule: rules[rule])
        optimum_ms = scores.links[link].optima_ms[MOVING]
        findings.append(
            f"No target covers {link}: ours {ratios[link]:.2f} times the best moving delay; the"
            f" least of the rules is {rules[best] / optimum_ms:.2f} ({best})."
        )
    shares = [rules[OURS].warped.late for rules in scores.rules.values()]
    findings.append(
        "At its default setting and with a display's slew limit, our estimator leaves"
        f" {percent(min(shares))} to {percent(max(shares))} of the frames late."
    )
    return findings


def _tables(
    title: str, links: Container[str], rows: Mapping[str, Callable[[str], str]], note: str = ""
) -> list[Table]:
    """Return a table for each group of links: one row for each rule, one column for each link."""
    present = {kind: [link for link in group if link in links] for kind, group in GROUPS.items()}
    return [
        Table(
            f"{title}: {kind} links",
            ("rule", *group),
            [(name, *map(cell, group)) for name, cell in rows.items()],
            note,
        )
        for kind, group in present.items()
        if group
    ]


def _targets_table(scores: PlayoutScores) -> Table:
    rows = []
    for link, optimum, target, ratio in compare_targets(scores):
        over_smallest = _ratio(scores, link, optimum, scores.links[link].smallest_ms)
        verdict = "met" if ratio <= target else "missed"
        figures = (f"{target:.2f}", f"{ratio:.3f}", verdict, f"{over_smallest:.3f}")
        rows.append((f"{link} / {optimum}", *figures))
    return Table(
        "Targets",
        ("link / optimum", "target", "ratio", "verdict", "over smallest"),
        rows,
        "Ratio: our mean delay over the optimum's; target: its greatest permitted value. Over"
        " smallest: the same after subtracting the trace's smallest delay, which no rule can avoid,"
        f" from both; it has no target. Links without a target: {', '.join(UNCOVERED)}.",
    )


def _default_chapter(scores: PlayoutScores) -> Chapter:
    def cell(rule: str, way: str, link: str) -> str:
        played: PlayedTrace = getattr(scores.rules[link][rule], way)
        return f"{played.delay_ms:.1f} ({percent(played.late)})"

    tables = []
    ways = {"default": "delay changes at once", "warped": "with a display's slew limit"}
    for way, how in ways.items():
        rows = {name: partial(cell, name, way) for name in RULES}
        tables += _tables(f"Mean delay in ms (late share), {how}", scores.links, rows)
    defaults = [f"{name} {rule.parameter} {rule.default:g}" for name, rule in RULES.items()]
    paragraphs = (
        f"Defaults: {', '.join(defaults)}.",
        "A display changes its playing speed by 5 % at most, so its delay rises by at most 50 ms"
        " per second. Our estimator gets this limit, and covers bursts that it would be too slow"
        " to follow.",
    )
    return Chapter("At default settings", paragraphs, tables)


def _draw(figure: "Figure", scores: PlayoutScores, link: str) -> None:
    axes = figure.add_subplot()
    curve = sorted(scores.links[link].curve, key=lambda played: played.late)
    best_ms, late = zip(*curve, strict=True)
    axes.plot(late, best_ms, color=text_colour(), label=MOVING)
    for style, (name, score) in zip(STYLES, scores.rules[link].items(), strict=False):
        delays_ms, late = zip(*score.tried, strict=True)
        axes.plot(late, delays_ms, style, markersize=4, label=name)
    axes.set_xscale("symlog", linthresh=1e-3)
    axes.set(
        xlim=(0, 0.3), ylim=(curve[-1].delay_ms * 0.9, 2.5 * scores.links[link].optima_ms[CONSTANT])
    )
    axes.set(xlabel="share of late frames", ylabel="mean delay (ms)")
    figure.legend(loc="outside lower center", ncols=4, fontsize="small")
