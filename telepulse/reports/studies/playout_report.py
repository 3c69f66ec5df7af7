"""The report of the study of playout: delay against late frames.

It has mean delays at 1 % late, targets, rules at their defaults, and curves of delay against the
late share.
"""

from collections.abc import Callable, Container, Mapping
from functools import partial
from typing import TYPE_CHECKING

from telepulse.document import STYLES, Chapter, Plot, Report, Table, percent, text_colour
from telepulse.reports.studies import playout_links as links
from telepulse.reports.studies.playout_rules import PlayedTrace
from telepulse.reports.studies.playout_scores import (
    CONSTANT,
    MOVING,
    OURS,
    RULES,
    TARGETS,
    PlayoutEffort,
    PlayoutScores,
    compare_targets,
    ratio_to_optimum,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

UNCOVERED = tuple(link for link in links.LINKS if link not in {each for each, *_ in TARGETS})
# In two tables, for a terminal's width.
GROUPS = {
    "steady": (links.GAUSSIAN, links.SPIKES, links.ROUTE, links.FAST, links.SLOW),
    "unsteady": (links.BURSTS, links.RANDOM, links.TCP, links.SHORT_BURSTS, links.DENSE),
}
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
    ratios = {link: ratio_to_optimum(scores, link, MOVING) for link in scores.links}
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
        over_smallest = ratio_to_optimum(scores, link, optimum, scores.links[link].smallest_ms)
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
