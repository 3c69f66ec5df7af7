"""The study of links as a report: choice of delay, error against delay, late samples, costs."""

from typing import TYPE_CHECKING

from display_node.prediction import PredictorName
from telepulse.reports.document import Chapter, Plot, Report, Table
from telepulse.reports.studies.link_scores import (
    AUTO,
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

# Stands for buffering alone: it is never trusted, so that auto plays what has arrived.
BUFFERED: PredictorName = "hold"
BEST: PredictorName = "stack"
STYLES = ("o-", "s--", "^-")


def report_links(scores: LinkScores, effort: LinkEffort) -> Report:
    """Return the report on scores that took this effort."""
    return Report(
        "Links: how much to buffer and how much to predict",
        (
            _choice_chapter(scores, effort),
            _curves_chapter(scores),
            _policies_chapter(scores),
            _costs_chapter(scores),
        ),
    )


def least_in_phase(
    scores: LinkScores, link: str, predictor: PredictorName
) -> tuple[float, LinkResult]:
    """Return the perceived delay in ms with the least error in phase, and its result."""
    return min(
        (
            (delay_ms, result)
            for delay_ms, result in scores.results[link][predictor].items()
            if delay_ms is not None
        ),
        key=lambda tried: tried[1].in_phase_n,
    )


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
    return Chapter(
        "Choice of the perceived delay",
        (
            "With the perceived delay E the finger feels the pulse of E ago. Samples that have"
            " arrived by then are played, the rest is predicted from the newest one. In phase:"
            " error against the pulse at that very instant; aligned: against the pulse of E ago.",
            *(advice(scores, link) for link in scores.results),
            f"Both nodes in virtual time, a radial pulse with heart-rate variability in frames of"
            f" 5 ms, {len(effort.seeds)} times {effort.seconds:g} s by another seed, after"
            f" {effort.settle_seconds:g} s to learn in. NRMSE: over the pulse's standard deviation;"
            " JND: a tenth of its peak to peak. The stack learns this one kind of pulse;"
            " arrhythmia is in `telepulse study prediction`. auto trusts the stack only after"
            " some time, if at all: its mean E may still be falling to 0.",
        ),
        (_choice_table(scores),),
    )


def _choice_table(scores: LinkScores) -> Table:
    rows = []
    for link, by_predictor in scores.results.items():
        for predictor, curve in by_predictor.items():
            delay_ms, best = least_in_phase(scores, link, predictor)
            rows.append((link, predictor, f"{delay_ms:g}", *_cells(best)))
            auto = curve[None]
            rows.append((link, predictor, f"{AUTO}: {auto.delay_ms:.1f}", *_cells(auto)))
    return Table(
        "The delay with the least error in phase, and the choice of auto",
        (
            "link",
            "predictor",
            "E (ms)",
            "predicted (ms)",
            "of ticks",
            "in phase NRMSE",
            "in phase (mN)",
            "in phase (JND)",
            "aligned (mN)",
            "above 25 Hz",
            "felt",
            "lost",
        ),
        tuple(rows),
        "Predicted: mean age of the newest sample over the played instant, and share of ticks."
        " Above 25 Hz: energy of the felt force over the pulse's. Felt: share of the time; the rest"
        " was faded out for want of samples.",
    )


def _cells(outcome: LinkResult) -> tuple[str, ...]:
    return (
        f"{outcome.horizon_ms:.1f}",
        f"{outcome.predicted:.0%}",
        f"{outcome.in_phase:.3f}",
        _mn(outcome.in_phase_n),
        f"{outcome.in_phase_jnd:.2f}",
        _mn(outcome.aligned_n),
        f"{outcome.roughness:.1f}",
        f"{outcome.felt:.1%}",
        f"{outcome.lost:.1%}",
    )


def _mn(force_n: float) -> str:
    return f"{force_n * 1e3:.1f}"


def _curves_chapter(scores: LinkScores) -> Chapter:
    links = list(scores.results)
    return Chapter(
        "Error against the buffered delay",
        ("The buffered and the predicted time add up to the network's delay.",),
        tuple(_curve_table(scores, link) for link in links),
        tuple(
            Plot(
                f"link-{number}",
                f"{link}: error in phase and aligned against the perceived delay. Stars: auto.",
                lambda figure, link=link: _draw(figure, scores, link),  # type: ignore[misc]
            )
            for number, link in enumerate(links, 1)
        ),
    )


def _curve_table(scores: LinkScores, link: str) -> Table:
    by_predictor = scores.results[link]
    rows = []
    for delay_ms, outcome in by_predictor[BUFFERED].items():
        if delay_ms is not None:
            errors = (by_predictor[predictor][delay_ms] for predictor in PREDICTORS)
            rows.append(
                (
                    f"{delay_ms:g}",
                    f"{outcome.horizon_ms:.1f}",
                    f"{outcome.longest_ms:.0f}",
                    f"{outcome.predicted:.0%}",
                    *(f"{error.in_phase:.3f} / {error.aligned:.3f}" for error in errors),
                )
            )
    return Table(
        f"{link}: NRMSE in phase / aligned",
        ("E (ms)", "predicted (ms)", "at most", "of ticks", *PREDICTORS),
        tuple(rows),
    )


def _draw(figure: "Figure", scores: LinkScores, link: str) -> None:
    in_phase, aligned = figure.subplots(1, 2, sharey=True)
    for style, (predictor, curve) in zip(STYLES, scores.results[link].items(), strict=True):
        tried = {delay_ms: each for delay_ms, each in curve.items() if delay_ms is not None}
        auto = curve[None]
        for axes, errors, chosen in (
            (in_phase, [each.in_phase for each in tried.values()], auto.in_phase),
            (aligned, [each.aligned for each in tried.values()], auto.aligned),
        ):
            (line,) = axes.plot(list(tried), errors, style, label=predictor)
            axes.plot(auto.delay_ms, chosen, "*", markersize=14, color=line.get_color())
    for axes, title in ((in_phase, "in phase"), (aligned, "aligned")):
        axes.set_title(title)
        axes.set_yscale("log")
        axes.set_xlabel("perceived delay E (ms)")
    in_phase.set_ylabel("NRMSE")
    figure.legend(*in_phase.get_legend_handles_labels(), loc="outside lower center", ncols=3)


def _policies_chapter(scores: LinkScores) -> Chapter:
    columns = tuple(f"E = {delay_ms} ms" for delay_ms in DELAYS_MS)
    rows = [("prototype's recording", name, "–", *_errors(PROTOTYPE[name])) for name in PROTOTYPE]
    rows += [
        (pulse, name, f"{each.classic_delay_ms}", *_errors(errors))
        for pulse, each in scores.policies.items()
        for name, errors in each.errors.items()
    ]
    return Chapter(
        "Late samples",
        (
            "Fresh is the display's policy: a late sample is never discarded but feeds the"
            " predictor. A classic jitter buffer delivers every sample after one fixed delay and"
            " discards the 1 % that come later; the same predictor continues from there."
            f" Over the link “{TCP}” as for the prototype, whose own link and recording are not"
            " here. heartpy's recording is included where heartpy is installed.",
        ),
        (
            Table(
                "NRMSE of the played values against the pulse of E ago",
                ("pulse", "late samples", "classic delay (ms)", *columns),
                tuple(rows),
            ),
        ),
    )


def _errors(errors: tuple[float, ...]) -> tuple[str, ...]:
    return tuple(f"{error:.3f}" for error in errors)


def _costs_chapter(scores: LinkScores) -> Chapter:
    return Chapter(
        "Cost",
        (
            "Processor time of one simulated millisecond, all of it predicted: both nodes, the link"
            " and the scoring. The difference from hold is the predictor's cost.",
        ),
        (
            Table(
                "Cost of a tick",
                ("predictor", "tick (µs)"),
                tuple((name, f"{cost_us:.0f}") for name, cost_us in scores.costs_us.items()),
            ),
        ),
    )
