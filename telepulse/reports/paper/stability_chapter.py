"""The chapter on numerical stability: hard cases, each stable or refused with a reason."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

from telepulse.reports.document import Chapter, Plot, Table
from telepulse.reports.paper import (
    stability_chatter,
    stability_inputs,
    stability_loops,
    stability_models,
)
from telepulse.reports.paper.pulse import deviation_n
from telepulse.reports.paper.stability import BOUND_N, StabilityOutcome, StabilityVerdict, newtons
from telepulse.reports.paper.stability_rates import (
    FILTERS_HZ,
    GAINS,
    PEAK_TO_PEAK_N,
    SECONDS,
    SETTLING_S,
    Sampled,
    measure,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = ("case", "what was run", "verdict", "figure", "why")
DEFECTS = (StabilityVerdict.FAILS, StabilityVerdict.WRONG)


def outcomes() -> Iterator[StabilityOutcome]:
    """Every hard case but the tick rates, run and judged."""
    yield from stability_loops.stiff_contact()
    yield from stability_loops.nearly_undamped()
    yield from stability_models.layers()
    yield from stability_models.exact_steps()
    yield from stability_loops.extreme_ticks()
    yield from stability_loops.saturated_steps()
    yield from stability_chatter.direction_chatter()
    yield from stability_loops.force_step()
    yield from stability_inputs.spikes()
    yield from stability_inputs.no_forces()
    yield from stability_inputs.peers()


def chapter() -> Chapter:
    """Run every case; in some seconds."""
    rates, cases = measure(), tuple(outcomes())
    return Chapter(
        "Numerical stability on hard cases",
        (_method(), _rates_in_words(rates), _sum(cases)),
        (_rates(rates), _cases(cases)),
        (_plot(rates),),
    )


def _method() -> str:
    return (
        "Every case runs the display's own code: the force loop that it builds, between Safety"
        " and the film, or its models. A verdict is computed from the run. Stable: felt force"
        f" finite, never beyond {BOUND_N:g} N, and in the end within a microstep (on eq 22, 1 %)"
        " of the force wanted, plus what the scene's film is off by. Refused: an error with a"
        " reason, or a fault that brings the finger to rest for good. Limit cycle: more than one"
        " microstep from peak to peak round a constant force. Fails, and says so: an error or a"
        " fault is named, but without a usable reason or without coming to rest. Silently wrong:"
        " the rest."
    )


def _rates_in_words(rates: tuple[Sampled, ...]) -> str:
    diverged = [each for each in rates if math.isinf(each.explicit_n)]
    worst_n = max(each.shipped_n for each in rates)
    broken = [each for each in rates if math.isinf(each.shipped_n)]
    nothing_n = PEAK_TO_PEAK_N * deviation_n("paper")
    lost = [each for each in rates if each.late_n > nothing_n]
    most = max((each.delay_ticks for each in lost), default=0.0)
    least = min((each.delay_ticks for each in rates if each not in lost), default=math.inf)
    fastest = {
        name: max((each.rate_hz for each in diverged if each.gains == name), default=0.0)
        for name in GAINS
    }
    upto = ", ".join(
        f"{rate_hz:g} Hz with the gains of the {name}" for name, rate_hz in fastest.items()
    )
    return (
        "The paper's gains on the error in mV by eq 21, over eq 22, on the paper's pulse. The"
        " explicit PID acts on the error of now and takes a backward difference; it diverges up"
        f" to {upto} ({len(diverged)} of {len(rates)} loops). The shipped PID acts on the error at"
        f" the tick's end, which the actuator's model gives: {len(broken)} of {len(rates)} loops"
        f" diverge or are refused, and the RMSE is at most {newtons(worst_n)}. It relies on that"
        f" model's timing: with the film read a tick late, {len(lost)} of them do worse than doing"
        " nothing, and a scene cannot name such a delay, so none is refused. The delay margin"
        f" foretells it: theirs are at most {most:.2f} ticks, the others' at least {least:.2f}."
    )


def _sum(cases: tuple[StabilityOutcome, ...]) -> str:
    count = Counter(outcome.verdict for outcome in cases)
    told = ", ".join(
        f"{count[verdict]} {verdict}" for verdict in StabilityVerdict if count[verdict]
    )
    wrong = [outcome for outcome in cases if outcome.verdict in DEFECTS]
    if not wrong:
        return f"Of the other {len(cases)} rows: {told}. Not one fails or is silently wrong."
    names = "; ".join(f"{outcome.run} ({outcome.verdict})" for outcome in wrong)
    return f"Of the other {len(cases)} rows: {told}. Not as they ought to be: {names}."


def _rates(rates: tuple[Sampled, ...]) -> Table:
    return Table(
        "The paper's gains over tick rates: explicit against shipped",
        (
            "gains, derivative's filter",
            "tick rate",
            "explicit, pole",
            "explicit",
            "shipped, pole",
            "shipped",
            "delay margin",
            "a tick late",
        ),
        tuple(_rate_row(each) for each in rates),
        f"Force RMSE on a pulse of {PEAK_TO_PEAK_N:g} N from peak to peak, from {SETTLING_S:g} to"
        f" {SECONDS:g} s. Pole: the largest, stable below 1. Diverges: beyond {BOUND_N:g} N."
        f" Margin in ticks. No filter: one of {max(FILTERS_HZ) / 1e3:g} kHz.",
        summary=f"{_rates_in_words(rates)} All {len(rates)} are on the page.",
    )


def _rate_row(each: Sampled) -> tuple[str, ...]:
    name = f"{each.gains}, " + (
        "none" if each.filter_hz == max(FILTERS_HZ) else f"{each.filter_hz:g} Hz"
    )
    return (
        name,
        f"{each.rate_hz:g} Hz",
        _pole(each.explicit_radius),
        _rmse(each.explicit_n),
        _pole(each.shipped_radius),
        each.refused or _rmse(each.shipped_n),
        f"{each.delay_ticks:.2f}",
        each.refused or _rmse(each.late_n),
    )


def _pole(radius: float) -> str:
    return f"{radius:.3g}" if radius >= 1 else f"1 − {1 - radius:.1e}"


def _rmse(force_n: float) -> str:
    return "diverges" if math.isinf(force_n) else newtons(force_n)


def _cases(cases: tuple[StabilityOutcome, ...]) -> Table:
    rows = tuple(
        (outcome.case, outcome.run, str(outcome.verdict), outcome.figure, outcome.reason)
        for outcome in cases
    )
    return Table("Hard cases", COLUMNS, rows, summary=f"{_sum(cases)} All are on the page.")


def _plot(rates: tuple[Sampled, ...]) -> Plot:
    """Largest pole and RMSE over the tick rate, without a derivative's filter."""
    bare = [each for each in rates if each.filter_hz == max(FILTERS_HZ)]

    def draw(figure: "Figure") -> None:
        poles, errors = figure.subplots(1, 2)
        for colour, name in enumerate(GAINS):
            own = [each for each in bare if each.gains == name]
            rate_hz = [each.rate_hz for each in own]
            shipped = {"color": f"C{colour}", "linewidth": 5.0, "alpha": 0.5}
            explicit = {"color": f"C{colour}", "linewidth": 1.2, "marker": "o", "linestyle": "--"}
            for of, style in (("shipped", shipped), ("explicit", explicit)):
                radius = [getattr(each, f"{of}_radius") for each in own]
                poles.plot(rate_hz, radius, label=f"{name}, {of}", **style)
                errors.plot(rate_hz, [1e3 * getattr(each, f"{of}_n") for each in own], **style)
        for axes in (poles, errors):
            axes.set(xscale="log", yscale="log", xlabel="tick rate in Hz")
        poles.set_ylabel("largest pole")
        errors.set(ylabel="force RMSE in mN", ylim=(0.1, 10))
        figure.legend(*poles.get_legend_handles_labels(), loc="outside lower center", ncols=2)

    return Plot(
        "stability",
        "The paper's gains in mV by eq 21 over the tick rate, derivative without a filter: the"
        " explicit PID is stable where its largest pole is below 1, and has no RMSE where it is"
        " not.",
        draw,
    )
