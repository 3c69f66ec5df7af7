"""The study of cost as a report: the Pareto front, both nodes as processes, and a slow host."""

import math
from functools import partial
from typing import TYPE_CHECKING

from telepulse.document import STYLES, Chapter, Plot, Report, Table, percent, text_colour
from telepulse.reports.studies.cost_scores import (
    EQUAL,
    LINK,
    NO_ERROR_N,
    SLOW,
    CostEffort,
    CostScores,
    Settings,
    SimulatedCost,
    late_delay_ms,
    late_errors_n,
    pareto_front,
    shipped,
)
from tests.support.netem import NodesOutcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FRONT, SHIPPED = "front", "shipped"
# Windows of a run with real processes that begin from here on are judged: those before it, while
# the display joins and predictors learn, and on a slow host the part without a quota, are not.
JUDGED_FROM_S = 6.0
# Limits of what works: a tenth of the ticks missed, and the error that a finger notices, a tenth of
# the pulse's height.
MISSED, NOTICED_N = 0.1, 0.03
# Reasons for shipped settings that this study alone would not choose.
REASONS = (
    "What the front leaves out: this pulse is regular, so that E = 0 and prediction are never wrong"
    " here; with E = auto a display returns to buffering where prediction fails. With E = auto,"
    " frames of 20 ms take E longer to fall than those of 5 ms, and the error in phase is larger."
    " A tick bounds the time for which a fault goes unnoticed and a drive holds a command,"
    " neither of which is an error here. Further connections are packets, and bring less delay only"
    " where packets are lost."
)
NAMES = ("tick (ms)", "predictor", "E (ms)", "frame (ms)", "paths")


def report_costs(scores: CostScores, effort: CostEffort) -> Report:
    """Return the report on scores that took this effort."""
    chapters = (_front_chapter(scores, effort), _live_chapter(scores), _slow_chapter(scores))
    return Report("Cost: speed against error", chapters)


def verdict(scores: CostScores) -> str:
    """Return whether the shipped settings are on the front, and otherwise what dominates them."""
    default, points = shipped(), scores.simulated
    front = dict(zip(points, _front(scores), strict=True))
    if front[default]:
        return f"The shipped settings ({default}) are on the front."
    mine = points[default].objectives()
    better = [
        str(one)
        for one, cost in points.items()
        if not pareto_front([mine, cost.objectives()], EQUAL)[0]
    ]
    return f"The shipped settings ({default}) are dominated by {len(better)}: {better[0]}."


def _front(scores: CostScores) -> list[bool]:
    return pareto_front([cost.objectives() for cost in scores.simulated.values()])


def _front_chapter(scores: CostScores, effort: CostEffort) -> Chapter:
    front = dict(zip(scores.simulated, _front(scores), strict=True))
    default = shipped()
    ordered = sorted(scores.simulated.items(), key=lambda item: item[1].load)
    rows = [_simulated_row(one, cost, front[one], one == default) for one, cost in ordered]
    best = [row for row in rows if row["mark"]]
    paragraphs = (
        REASONS,
        f"{len(rows)} settings over {LINK} (TCP) in virtual time, {effort.seconds:g} s each after"
        f" {effort.settle_seconds:g} s. Load is the processor time of both nodes, link and scoring"
        " over the stream's time; the tick is theirs too. Packets are frames with copies.",
        "A setting is on the front if none is at least as good in all of: error in phase, error"
        " aligned, load, packets. An error below"
        f" {NO_ERROR_N * 1e3:g} mN counts as {NO_ERROR_N * 1e3:g} mN, since a finger notices 30;"
        f" differences below {percent(EQUAL, '.0f')} count as none.",
    )
    plot = Plot(
        "cost-1",
        "Error in phase against load. Each point is a setting; those with a ring are on the front.",
        partial(_draw, scores=scores, front=front),
    )
    tables = (
        Table.of("The front, and what is shipped", best),
        Table.of("All settings", rows, summary=f"{len(rows)} settings, on the page and in --json"),
    )
    return Chapter("Simulated", paragraphs, tables, (plot,), (verdict(scores),))


def _simulated_row(
    one: Settings, cost: SimulatedCost, on_front: bool, is_default: bool
) -> dict[str, str]:
    marks = [name for name, holds in ((FRONT, on_front), (SHIPPED, is_default)) if holds]
    return _named(one) | {
        "in phase (mN)": f"{cost.in_phase_n * 1e3:.2f}",
        "aligned (mN)": f"{cost.aligned_n * 1e3:.2f}",
        "mean E (ms)": f"{cost.delay_ms:z.1f}",
        "p50 (µs)": f"{cost.p50_us:.0f}",
        "p99 (µs)": f"{cost.p99_us:.0f}",
        "load (%)": f"{100 * cost.load:.1f}",
        "packets/s": f"{cost.frames_per_s:.0f}",
        "mark": ", ".join(marks),
    }


def _named(one: Settings) -> dict[str, str]:
    delay = "auto" if one.delay_ms is None else f"{one.delay_ms:g}"
    values = (
        f"{one.tick_ms:g}",
        one.predictor,
        delay,
        f"{one.batch_ms:g}",
        str(one.paths),
    )
    return dict(zip(NAMES, values, strict=True))


def _live_row(one: Settings, run: NodesOutcome, seconds: float) -> dict[str, str]:
    display, carried = run.display, run.carried
    in_phase_n, aligned_n = late_errors_n(display, JUDGED_FROM_S)
    tick_us, missed = display.loop.tick_us, display.loop.last_5s.missed
    row = _named(one) | {
        "in phase (mN)": f"{in_phase_n * 1e3:.2f}",
        "aligned (mN)": f"{aligned_n * 1e3:.2f}",
        "mean E (ms)": f"{late_delay_ms(display, JUDGED_FROM_S):z.1f}",
        "p50 (µs)": f"{tick_us.p50 or math.nan:.0f}",
        "p99 (µs)": f"{tick_us.p99 or math.nan:.0f}",
        "missed (%)": f"{100 * (math.nan if missed is None else missed):.1f}",
        "sensing CPU (%)": _percent(run.sensing_cpu),
        "display CPU (%)": _percent(run.display_cpu),
    }
    if carried is not None:
        row |= {
            "packets/s": f"{carried.packets / seconds:.0f}",
            "kB/s": f"{carried.bytes / seconds / 1e3:.1f}",
        }
    return row


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{100 * share:.1f}"


def _live_chapter(scores: CostScores) -> Chapter:
    title = "Real processes"
    if scores.not_live:
        return Chapter(title, (f"Left out: {scores.not_live}.",))
    rows = [_live_row(one, run, scores.live_seconds) for one, run in scores.live.items()]
    paragraphs = (
        f"Both nodes as processes over the kernel's TCP on a link of {LINK}, the shipped settings"
        " first, then each with one other value. Errors are a display's own, which knows the"
        " received pulse only. Processor time is that of all threads over the stream's time, in %"
        " of a core of this machine. Packets and bytes are those of both directions, with"
        " acknowledgements, control and IP headers.",
    )
    return Chapter(title, paragraphs, (Table.of(title, rows),))


def _slow_chapter(scores: CostScores) -> Chapter:
    title = "A host of a tenth of this speed"
    if scores.not_slow:
        return Chapter(title, (f"Left out: {scores.not_slow}.",))
    rows = []
    for one, run in scores.slow.items():
        row = _live_row(one, run, scores.live_seconds)
        row["interruptions"] = str(run.display.interruptions.count)
        row["works"] = "yes" if works(run) else "no"
        rows.append({key: row[key] for key in SLOW_COLUMNS})
    paragraphs = (
        f"As before, but each node has {percent(SLOW, '.0f')} of a core from the fourth second on,"
        " by a quota"
        f" of cgroups: 1 ms in every {1 / SLOW:g} ms. A slow processor would have no such pauses,"
        " so this is the harsher test. The change itself, within the run, may interrupt the pulse."
        f" Works: at the end fewer than {percent(MISSED, '.0f')} of the ticks are missed, and the"
        " aligned error"
        f" is below the {NOTICED_N * 1e3:g} mN that a finger notices.",
    )
    return Chapter(title, paragraphs, (Table.of(title, rows),))


SLOW_COLUMNS = (
    *NAMES[:4],
    "in phase (mN)",
    "aligned (mN)",
    "mean E (ms)",
    "sensing CPU (%)",
    "display CPU (%)",
    "missed (%)",
    "interruptions",
    "works",
)


def works(run: NodesOutcome) -> bool:
    """Return whether few ticks were missed at a run's end, and its error goes unnoticed."""
    missed = run.display.loop.last_5s.missed
    _, aligned_n = late_errors_n(run.display, JUDGED_FROM_S)
    return missed is not None and missed < MISSED and aligned_n < NOTICED_N


def _draw(figure: "Figure", scores: CostScores, front: dict[Settings, bool]) -> None:
    axes, ink = figure.add_subplot(), text_colour()
    predictors = list(dict.fromkeys(one.predictor for one in scores.simulated))
    for style, predictor in zip(STYLES, predictors, strict=False):
        chosen = [
            (100 * cost.load, cost.in_phase_n * 1e3, front[one])
            for one, cost in scores.simulated.items()
            if one.predictor == predictor
        ]
        load, error_mn, _ = zip(*chosen, strict=True)
        axes.plot(load, error_mn, style[0], markersize=5, label=predictor)
        best = [(x, y) for x, y, on_front in chosen if on_front]
        if best:
            x, y = zip(*best, strict=True)
            axes.plot(
                x, y, style[0], markersize=7, markeredgewidth=1.8, fillstyle="none", color=ink
            )
    default = scores.simulated[shipped()]
    axes.annotate(SHIPPED, (100 * default.load, default.in_phase_n * 1e3))
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set(xlabel="load (% of a core)", ylabel="error in phase (mN)")
    figure.legend(loc="outside lower center", ncols=4, fontsize="small")
