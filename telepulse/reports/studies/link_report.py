"""The study of links as a report: choice of delay, error against delay, late samples, costs."""

from functools import partial
from typing import TYPE_CHECKING

from display_node.prediction import PredictorName
from telepulse.document import STYLES, Chapter, Plot, Report, Table, percent
from telepulse.reports.studies.link_scores import (
    DELAYS_MS,
    PREDICTORS,
    PROTOTYPE,
    TCP,
    LinkEffort,
    LinkResult,
    LinkScores,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# The predictor of the cases with buffering alone: auto never trusts it, and plays arrived samples.
BUFFERED: PredictorName = "hold"
BEST: PredictorName = "stack"


def report_links(scores: LinkScores, effort: LinkEffort) -> Report:
    """Return the report on scores of simulations of this number and length."""
    words = (
        "Processor time of one simulated millisecond, all of it predicted: both nodes, the link"
        " and the scoring. The difference from hold is the predictor's cost."
    )
    costs = [(name, f"{cost_us:.0f}") for name, cost_us in scores.costs_us.items()]
    table = Table("Cost of a tick", ("predictor", "tick (µs)"), costs)
    return Report(
        "Links: how much to buffer and how much to predict",
        (
            _choice_chapter(scores, effort),
            _curves_chapter(scores),
            _policies_chapter(scores),
            Chapter("Cost", (words,), (table,)),
        ),
    )


def least_in_phase(
    scores: LinkScores, link: str, predictor: PredictorName
) -> tuple[float, LinkResult]:
    """Return the perceived delay in ms with the least error in phase, and its result."""
    curve = scores.results[link][predictor]
    tried = [(delay_ms, result) for delay_ms, result in curve.items() if delay_ms is not None]
    return min(tried, key=lambda one: one[1].in_phase_n)


def advice(scores: LinkScores, link: str) -> str:
    """Return a sentence on the two delays that a user can choose between over a link."""
    buffered = scores.results[link][BUFFERED][None]
    delay_ms, best = least_in_phase(scores, link, BEST)
    share = "all" if delay_ms == 0 else f"all beyond a buffer of {delay_ms:g} ms"
    return (
        f"Over {link}: with a buffer of {buffered.delay_ms:.0f} ms, the pulse of that long ago is"
        f" felt with an error of {_mn(buffered.aligned_n)} mN; its error in phase is"
        f" {_mn(buffered.in_phase_n)} mN ({buffered.in_phase_jnd:.2f} JND). With the {BEST}"
        f" predicting {share}, on average {best.horizon_ms:.0f} ms ahead, the error in phase is"
        f" {_mn(best.in_phase_n)} mN ({best.in_phase_jnd:.2f} JND)."
    )


def _choice_chapter(scores: LinkScores, effort: LinkEffort) -> Chapter:
    rows = []
    for link, by_predictor in scores.results.items():
        for predictor, curve in by_predictor.items():
            delay_ms, best = least_in_phase(scores, link, predictor)
            auto = curve[None]
            rows.append(_choice(link, predictor, f"{delay_ms:g}", best))
            rows.append(_choice(link, predictor, f"auto: {auto.delay_ms:.1f}", auto))
    paragraphs = (
        "With the perceived delay E the finger feels the pulse as it was E ago. Samples of that"
        " instant that have arrived are played, the others are predicted from the newest sample."
        " In phase: error against the present pulse; aligned: against the pulse E before.",
        *(advice(scores, link) for link in scores.results),
        f"Both nodes in virtual time, a radial pulse with heart-rate variability in frames of"
        f" 5 ms, {len(effort.seeds)} runs of {effort.seconds:g} s, each with its own seed, after"
        f" {effort.settle_seconds:g} s in which the predictor learns. NRMSE: over the pulse's"
        " standard deviation; JND: a tenth of its peak to peak. The stack learns this one kind of"
        " pulse; arrhythmia is"
        " in `telepulse study prediction`. auto trusts the stack only after some time, if at all:"
        " its mean E may still be falling to 0.",
    )
    table = Table.of(
        "The delay with the least error in phase, and the choice of auto",
        rows,
        "Predicted: mean time from the newest sample to the played instant, and share of ticks."
        " Above 25 Hz: energy of the felt force over the pulse's. Felt: share of the time; in the"
        " rest the force was faded out, since samples were missing.",
    )
    return Chapter(
        "Choice of the perceived delay",
        paragraphs,
        (table,),
        findings=[_short(scores, link) for link in scores.results],
    )


def _short(scores: LinkScores, link: str) -> str:
    buffered = scores.results[link][BUFFERED][None]
    _, best = least_in_phase(scores, link, BEST)
    return (
        f"{link}: {_mn(buffered.in_phase_n)} mN in phase with a buffer of"
        f" {buffered.delay_ms:.0f} ms, {_mn(best.in_phase_n)} mN with the {BEST}."
    )


def _choice(link: str, predictor: str, delay: str, result: LinkResult) -> dict[str, str]:
    return {
        "link": link,
        "predictor": predictor,
        "E (ms)": delay,
        "predicted (ms)": f"{result.horizon_ms:.1f}",
        "of ticks": percent(result.predicted, ".0f"),
        "in phase NRMSE": f"{result.in_phase:.3f}",
        "in phase (mN)": _mn(result.in_phase_n),
        "in phase (JND)": f"{result.in_phase_jnd:.2f}",
        "aligned (mN)": _mn(result.aligned_n),
        "above 25 Hz": f"{result.roughness:.1f}",
        "felt": percent(result.felt),
        "lost": percent(result.lost),
    }


def _mn(force_n: float) -> str:
    return f"{force_n * 1e3:.1f}"


def _curves_chapter(scores: LinkScores) -> Chapter:
    tables, plots = [], []
    for number, (link, curves) in enumerate(scores.results.items(), 1):
        rows = [
            {
                "E (ms)": f"{delay_ms:g}",
                "predicted (ms)": f"{result.horizon_ms:.1f}",
                "at most": f"{result.longest_ms:.0f}",
                "of ticks": percent(result.predicted, ".0f"),
            }
            | {
                predictor: f"{curve[delay_ms].in_phase:.3f} / {curve[delay_ms].aligned:.3f}"
                for predictor, curve in curves.items()
            }
            for delay_ms, result in curves[BUFFERED].items()
            if delay_ms is not None
        ]
        tables.append(Table.of(f"{link}: NRMSE in phase / aligned", rows))
        caption = f"{link}: error in phase and aligned against the perceived delay. Stars: auto."
        plots.append(Plot(f"link-{number}", caption, partial(_draw, scores=scores, link=link)))
    words = "The buffered and the predicted time add up to the network's delay."
    return Chapter("Error against the buffered delay", (words,), tables, plots)


def _draw(figure: "Figure", scores: LinkScores, link: str) -> None:
    panels = figure.subplots(1, 2, sharey=True)
    for style, predictor in zip(STYLES, PREDICTORS, strict=False):
        tried = dict(scores.results[link][predictor])
        auto = tried.pop(None)
        for axes, error in zip(panels, ("in_phase", "aligned"), strict=True):
            errors = [getattr(each, error) for each in tried.values()]
            (line,) = axes.plot(list(tried), errors, style, label=predictor)
            chosen = getattr(auto, error)
            axes.plot(auto.delay_ms, chosen, "*", markersize=14, color=line.get_color())
    for axes, title in zip(panels, ("in phase", "aligned"), strict=True):
        axes.set(title=title, yscale="log", xlabel="perceived delay E (ms)")
    panels[0].set_ylabel("NRMSE")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3)


def _policies_chapter(scores: LinkScores) -> Chapter:
    ours = [
        (pulse, name, f"{each.classic_delay_ms}", errors)
        for pulse, each in scores.policies.items()
        for name, errors in each.errors.items()
    ]
    printed = [("prototype's recording", name, "–", errors) for name, errors in PROTOTYPE.items()]
    rows = [
        {"pulse": pulse, "late samples": name, "classic delay (ms)": delay}
        | {f"E = {at} ms": f"{error:.3f}" for at, error in zip(DELAYS_MS, errors, strict=True)}
        for pulse, name, delay, errors in printed + ours
    ]
    words = (
        "Fresh is the display's policy: a late sample is not discarded but used by the predictor."
        " A classic jitter buffer delivers every sample after one fixed delay and discards the 1 %"
        " that come later; beyond the newest delivered sample the same predictor is used."
        f" The link is “{TCP}”; the figures of “prototype's recording” are those of an earlier"
        " prototype of"
        " this project, over a link of these settings."
        " heartpy's recording is included where heartpy is installed."
    )
    table = Table.of("NRMSE of the played values against the pulse of E ago", rows)
    return Chapter("Late samples", (words,), (table,))
