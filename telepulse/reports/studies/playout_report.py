"""The study of playout as a report: delay at 1 % late, targets, defaults, delay against late."""

import itertools
from operator import attrgetter
from typing import TYPE_CHECKING

from telepulse.reports.document import Chapter, Plot, Report, Table
from telepulse.reports.studies.playout_links import (
    BURSTS,
    DENSE,
    FAST,
    GAUSSIAN,
    RANDOM,
    ROUTE,
    SHORT_BURSTS,
    SLOW,
    SPIKES,
    TCP,
)
from telepulse.reports.studies.playout_rules import PlayedTrace
from telepulse.reports.studies.playout_scores import (
    OURS,
    RULES,
    LinkScore,
    PlayoutEffort,
    PlayoutScores,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONSTANT, MOVING = "best constant", "best moving, 5 %"
# Required at most: mean delay at 1 % late over an optimum's.
TARGETS = (
    (GAUSSIAN, CONSTANT, 1.05),
    (SPIKES, CONSTANT, 1.05),
    (GAUSSIAN, MOVING, 1.15),
    (ROUTE, MOVING, 1.15),
    (FAST, MOVING, 1.15),
    (SLOW, MOVING, 1.15),
    (BURSTS, MOVING, 1.2),
    (RANDOM, MOVING, 1.6),
    (TCP, MOVING, 1.7),
)
STEADY = (GAUSSIAN, SPIKES, ROUTE, FAST, SLOW)
UNSTEADY = (BURSTS, RANDOM, TCP, SHORT_BURSTS, DENSE)
CURVES = (GAUSSIAN, BURSTS, TCP)
STYLES = ("o-", "s--", "^-", "v--", "P-", "x:", "D-")


def report_playout(scores: PlayoutScores, effort: PlayoutEffort) -> Report:
    """Return the report on scores that took this effort."""
    return Report(
        "Playout: delay against late frames",
        (_frontier_chapter(scores, effort), _default_chapter(scores), _curves_chapter(scores)),
    )


def compare_targets(scores: PlayoutScores) -> list[tuple[str, str, float, float]]:
    """Return link, optimum, target and our ratio of mean delays, for each link that was played."""
    return [
        (link, optimum, target, _ratio(scores, link, optimum))
        for link, optimum, target in TARGETS
        if link in scores.links
    ]


def _optimum_ms(score: LinkScore, optimum: str) -> float:
    return score.constant_ms if optimum == CONSTANT else score.moving_ms


def _ratio(scores: PlayoutScores, link: str, optimum: str, over_smallest: bool = False) -> float:
    score = scores.links[link]
    path_ms = score.smallest_ms if over_smallest else 0.0
    ours_ms = scores.rules[link][OURS].tuned.delay_ms
    return (ours_ms - path_ms) / (_optimum_ms(score, optimum) - path_ms)


def _frontier_chapter(scores: PlayoutScores, effort: PlayoutEffort) -> Chapter:
    gaps = [score.found_ms / score.moving_ms - 1 for score in scores.links.values()]
    return Chapter(
        f"At {effort.late:.0%} late",
        (
            _targets_sentence(scores),
            f"Each link is a trace of {effort.seconds:g} s with a frame every 5 ms; every rule"
            " sees the same delays. An instant is played once, when it is first the delay in use"
            " ago: a delay that grows because a frame came late cannot save that frame. Here a"
            " delay may change at once, as the published rules have it. Each rule's own parameter"
            " is set for the least mean delay with at most the share late.",
            "Both optima are computed from the whole trace. The moving one may change by 5 % of"
            " time; its row is a lower bound of all such paths (the paths that were found are at"
            f" most {max(gaps):.1%} above it).",
        ),
        (*_delay_tables(scores), _targets_table(scores)),
    )


def _targets_sentence(scores: PlayoutScores) -> str:
    judged = compare_targets(scores)
    missed = [f"{link} / {optimum}" for link, optimum, target, ratio in judged if ratio > target]
    if missed:
        return f"{len(judged) - len(missed)} of {len(judged)} targets are met; missed: " + (
            "; ".join(missed) + "."
        )
    return f"All {len(judged)} targets are met."


def _delay_tables(scores: PlayoutScores) -> tuple[Table, ...]:
    rows: dict[str, dict[str, str]] = {
        optimum: {
            link: _against(_optimum_ms(score, optimum), score)
            for link, score in scores.links.items()
        }
        for optimum in (CONSTANT, MOVING)
    }
    for name in RULES:
        rows[name] = {link: _tuned(scores, link, name) for link in scores.links}
    return _tables(
        "Mean delay in ms (over the best moving delay)",
        rows,
        "Tuned to the share late. Where no setting is within it, the share late is given.",
    )


def _tuned(scores: PlayoutScores, link: str, name: str) -> str:
    score = scores.rules[link][name]
    missed = "" if score.reached else f" at {score.tuned.late:.1%}"
    return _against(score.tuned.delay_ms, scores.links[link]) + missed


def _against(delay_ms: float, score: LinkScore) -> str:
    return f"{delay_ms:.1f} ({delay_ms / score.moving_ms:.2f})"


def _tables(title: str, rows: dict[str, dict[str, str]], note: str = "") -> tuple[Table, ...]:
    """Return two tables, for a terminal's width, with a row a rule and a column a link."""
    present = set(next(iter(rows.values())))
    groups = (("steady", STEADY), ("unsteady", UNSTEADY))
    return tuple(
        Table(
            f"{title}: {kind} links",
            ("rule", *links),
            tuple((name, *(cells[link] for link in links)) for name, cells in rows.items()),
            note,
        )
        for kind, group in groups
        if (links := [link for link in group if link in present])
    )


def _targets_table(scores: PlayoutScores) -> Table:
    rows = [
        (
            f"{link} / {optimum}",
            f"{target:.2f}",
            f"{ratio:.3f}",
            "met" if ratio <= target else "missed",
            f"{_ratio(scores, link, optimum, over_smallest=True):.3f}",
        )
        for link, optimum, target, ratio in compare_targets(scores)
    ]
    return Table(
        "Targets",
        ("link / optimum", "bar", "ratio", "verdict", "over smallest"),
        tuple(rows),
        "Bar: the target. Ratio: our mean delay over the optimum's. Over smallest: the same without"
        " the trace's smallest delay in both, which no rule can avoid; it has no target.",
    )


def _default_chapter(scores: PlayoutScores) -> Chapter:
    parts = (f"{rule.name} {rule.parameter} {rule.default:g}" for rule in RULES.values())
    defaults = ", ".join(parts)
    by_name = {name: {link: rules[name] for link, rules in scores.rules.items()} for name in RULES}
    free, warped = (
        {
            name: {link: _played(pick(score)) for link, score in row.items()}
            for name, row in by_name.items()
        }
        for pick in (attrgetter("default"), attrgetter("warped"))
    )
    return Chapter(
        "At default settings",
        (
            f"Defaults: {defaults}.",
            "A display warps its time by 2 % at most, so its delay rises by at most 20 ms a"
            " second. Our estimator gets this limit and covers bursts that it would be too slow to"
            " follow.",
        ),
        (
            *_tables("Mean delay in ms and share late, changed at once", free),
            *_tables("Mean delay in ms and share late, as a display plays it", warped),
        ),
    )


def _played(played: PlayedTrace) -> str:
    return f"{played.delay_ms:.1f} {played.late:.1%}"


def _curves_chapter(scores: PlayoutScores) -> Chapter:
    drawn = [link for link, score in scores.links.items() if len(score.curve) > 1]
    return Chapter(
        "Delay against the share late",
        plots=tuple(
            Plot(
                f"playout-{number}",
                f"{link}: mean delay against the share late, a point a setting of each rule."
                " Lower left is better. The line without marks is the best moving delay.",
                lambda figure, link=link: _draw(figure, scores, link),  # type: ignore[misc]
            )
            for number, link in enumerate(drawn, 1)
        ),
    )


def _draw(figure: "Figure", scores: PlayoutScores, link: str) -> None:
    from matplotlib import rcParams

    axes = figure.add_subplot()
    curve = sorted(scores.links[link].curve, key=lambda played: played.late)
    axes.plot(
        [played.late for played in curve],
        [played.delay_ms for played in curve],
        color=rcParams["text.color"],
        label=MOVING,
    )
    for style, (name, score) in zip(
        itertools.cycle(STYLES), scores.rules[link].items(), strict=False
    ):
        axes.plot(
            [played.late for played in score.tried],
            [played.delay_ms for played in score.tried],
            style,
            markersize=4,
            label=name,
        )
    axes.set_xscale("symlog", linthresh=1e-3)
    axes.set_xlim(0, 0.3)
    axes.set_ylim(curve[-1].delay_ms * 0.9, 2.5 * scores.links[link].constant_ms)
    axes.set_xlabel("share of late frames")
    axes.set_ylabel("mean delay (ms)")
    figure.legend(loc="outside lower center", ncols=4, fontsize="small")
