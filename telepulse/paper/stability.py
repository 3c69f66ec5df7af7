"""The chapter on numerical stability: the paper's gains over tick rates, and the hard cases.

With the paper's gains, a textbook's explicit PID runs beside the shipped one, whose poles and
margins `control/linear_loop.py` computes. Each hard case is stable, or refused with a reason.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from display_node.control.linear_loop import linear_loop, margins
from display_node.plant.second_order import SecondOrder
from display_node.scene import DisplayScene
from protocol.errors import SceneError
from telepulse.document import Chapter, Plot, Table
from telepulse.paper import input_cases, loop_cases, published
from telepulse.paper.explicit_loop import close_loop, spectral_radius
from telepulse.paper.hard_case import (
    BOUND_N,
    HELD_N,
    Array,
    CaseResult,
    CaseVerdict,
    force_text,
    paper_setup,
    refusal_reason,
)
from telepulse.paper.published import GAINS, Gains
from telepulse.paper.pulse_spectrum import beats, deviation_n

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RATES_HZ = (100.0, 200.0, 500.0, 1_000.0, 2_000.0, 5_000.0, 10_000.0)
# The filter of the display's scene, and one so far above every tick rate that it has no effect.
FILTERS_HZ = (200.0, 100_000.0)
NO_FILTER_HZ = max(FILTERS_HZ)
SECONDS = 2.0
SETTLING_S = 1.0
PEAK_TO_PEAK_N = 0.3
FREQUENCIES = 400
# Verdicts after a number of cases.
IN_WORDS = {
    CaseVerdict.STABLE: "are stable",
    CaseVerdict.REFUSED: "are refused",
    CaseVerdict.CYCLES: "end in a limit cycle",
    CaseVerdict.FAILS: "fail with a named reason",
    CaseVerdict.WRONG: "are silently wrong",
}


class RateResult(NamedTuple):
    """One gain set at one tick rate.

    explicit_radius, shipped_radius: the largest pole, stable below 1. explicit_n, shipped_n,
    late_n: force RMSE in N, infinite where the loop diverged; late: the shipped loop, its film read
    a tick late. margin_ticks: delay margin of the shipped loop. refused: the display's reason not
    to run it, or None.
    """

    gains: str
    filter_hz: float
    rate_hz: float
    explicit_radius: float
    shipped_radius: float
    explicit_n: float
    shipped_n: float
    late_n: float
    margin_ticks: float
    refused: str | None


def measure() -> list[RateResult]:
    """Run both gain sets, with and without a filter, at every rate."""
    return [_run(*case) for case in product(GAINS, FILTERS_HZ, RATES_HZ)]


def _run(name: str, filter_hz: float, rate_hz: float) -> RateResult:
    gains, tick_s = GAINS[name], 1 / rate_hz
    # The pulse begins at 0 N: a step at the start would excite a small ki's slow mode, which lasts
    # longer than the run.
    shape = beats("paper", rate_hz, SECONDS)
    wanted_n = PEAK_TO_PEAK_N * (shape - shape[0])
    setup = paper_setup(gains, filter_hz, tick_s)
    layer = setup.layer.layer()
    linear = linear_loop(setup.controller, setup.actuator, layer, setup.film, tick_s, HELD_N)
    found = margins(linear, FREQUENCIES)
    shipped_n, late_n, refused = math.inf, math.inf, None
    try:
        shipped_n, late_n = (_shipped_rmse_n(setup, wanted_n, late) for late in (False, True))
    except SceneError as error:
        refused = refusal_reason(error)
    return RateResult(
        name,
        filter_hz,
        rate_hz,
        spectral_radius(rate_hz, gains, 2 * math.pi * filter_hz),
        found.pole_radius,
        _explicit_rmse_n(gains, filter_hz, wanted_n, tick_s),
        shipped_n,
        late_n,
        found.delay_s / tick_s,
        refused,
    )


def _shipped_rmse_n(setup: DisplayScene, wanted_n: Array, late: bool) -> float:
    loop, reference_n = setup.force_loop(), wanted_n.tolist()
    reading_n, felt_n = 0.0, []
    for tick in range(len(reference_n) - 1):
        before_n, reading_n = reading_n, loop.read_film()
        loop.tick(reference_n[tick : tick + 2], before_n if late else reading_n)
        felt_n.append(loop.felt_n)
    return _rmse_n(felt_n, wanted_n, setup.tick_ns * 1e-9)


def _explicit_rmse_n(gains: Gains, filter_hz: float, wanted_n: Array, tick_s: float) -> float:
    step, reference_n = SecondOrder(published.ACTUATOR, tick_s).step, wanted_n.tolist()[:-1]
    felt_n, _ = close_loop(step, tick_s, reference_n, gains, filter_hz)
    return _rmse_n(felt_n, wanted_n, tick_s)


def _rmse_n(felt_n: list[float], wanted_n: Array, tick_s: float) -> float:
    if not np.abs(felt_n).max() <= BOUND_N:
        return math.inf
    error_n = (np.array(felt_n) - wanted_n[1:])[round(SETTLING_S / tick_s) :]
    return float(np.sqrt(np.mean(error_n**2)))


def _rates_summary(rates: Sequence[RateResult]) -> str:
    """Return a paragraph on which loops diverged, with and without a tick of delay."""
    diverged = [each for each in rates if math.isinf(each.explicit_n)]
    broken = [each for each in rates if math.isinf(each.shipped_n)]
    nothing_n = PEAK_TO_PEAK_N * deviation_n("paper")
    worse = [each for each in rates if each.late_n > nothing_n]
    most = max((each.margin_ticks for each in worse), default=0.0)
    least = min((each.margin_ticks for each in rates if each not in worse), default=math.inf)
    fastest_hz = {
        name: max((each.rate_hz for each in diverged if each.gains == name), default=0.0)
        for name in GAINS
    }
    up_to = ", ".join(f"{hz:g} Hz with the gains of the {name}" for name, hz in fastest_hz.items())
    return (
        "The paper's gains act on the error in mV by eq 21. They drive the paper's actuator, eq 22,"
        " on the paper's pulse. The explicit PID uses the error at the tick's beginning and a"
        f" backward difference. It diverges up to {up_to} ({len(diverged)} of {len(rates)} loops)."
        " The shipped PID uses the error at the tick's end, which the actuator's model predicts:"
        f" {len(broken)} of {len(rates)} loops diverge or are refused, and the RMSE is at most"
        f" {force_text(max(each.shipped_n for each in rates))}. This PID depends on the"
        f" timing of that model: with the film read a tick late, {len(worse)} of these loops are"
        " worse than doing nothing. A scene cannot describe such a delay, so the display refuses"
        " none of them. The delay margin predicts which loops are worse: it is at most"
        f" {most:.2f} ticks in them, and at least {least:.2f} in the others."
    )


def _rates_table(rates: Sequence[RateResult], summary: str) -> Table:
    def pole(radius: float) -> str:
        return f"{radius:.3g}" if radius >= 1 else f"1 − {1 - radius:.1e}"

    def rmse(force_n: float) -> str:
        return "diverges" if math.isinf(force_n) else force_text(force_n)

    filters = {hz: "none" if hz == NO_FILTER_HZ else f"{hz:g} Hz" for hz in FILTERS_HZ}
    rows = [
        {
            "gains, derivative's filter": f"{each.gains}, {filters[each.filter_hz]}",
            "tick rate": f"{each.rate_hz:g} Hz",
            "explicit, pole": pole(each.explicit_radius),
            "explicit": rmse(each.explicit_n),
            "shipped, pole": pole(each.shipped_radius),
            "shipped": each.refused or rmse(each.shipped_n),
            "delay margin": f"{each.margin_ticks:.2f}",
            "a tick late": each.refused or rmse(each.late_n),
        }
        for each in rates
    ]
    return Table.of(
        "The paper's gains over tick rates: explicit against shipped",
        rows,
        f"Force RMSE on a pulse of {PEAK_TO_PEAK_N:g} N from peak to peak, from {SETTLING_S:g} to"
        f" {SECONDS:g} s. Pole: the largest magnitude; the loop is stable below 1. Diverges: the"
        f" force exceeds {BOUND_N:g} N. Delay margin in ticks. No filter: a corner of"
        f" {NO_FILTER_HZ / 1e3:g} kHz.",
        f"{summary} All {len(rates)} loops are in the page written to --out.",
    )


def _draw_rates(figure: "Figure", rates: Sequence[RateResult]) -> None:
    poles, errors = figure.subplots(1, 2)
    for colour, name in enumerate(GAINS):
        own = [each for each in rates if (each.gains, each.filter_hz) == (name, NO_FILTER_HZ)]
        rate_hz = [each.rate_hz for each in own]
        shipped = {"color": f"C{colour}", "linewidth": 5.0, "alpha": 0.5}
        explicit = {"color": f"C{colour}", "linewidth": 1.2, "marker": "o", "linestyle": "--"}
        for loop, style in (("shipped", shipped), ("explicit", explicit)):
            radius = [getattr(each, f"{loop}_radius") for each in own]
            poles.plot(rate_hz, radius, label=f"{name}, {loop}", **style)
            errors.plot(rate_hz, [1e3 * getattr(each, f"{loop}_n") for each in own], **style)
    for axes in (poles, errors):
        axes.set(xscale="log", yscale="log", xlabel="tick rate in Hz")
    poles.set_ylabel("largest pole")
    errors.set(ylabel="force RMSE in mN", ylim=(0.1, 10))
    figure.legend(*poles.get_legend_handles_labels(), loc="outside lower center", ncols=2)


def case_results() -> Iterator[CaseResult]:
    """Run and judge every hard case but the tick rates."""
    yield from loop_cases.stiff_contact()
    yield from loop_cases.nearly_undamped()
    yield from input_cases.layers()
    yield from input_cases.exact_steps()
    yield from loop_cases.extreme_ticks()
    yield from loop_cases.saturated_steps()
    yield from loop_cases.direction_chatter()
    yield from loop_cases.force_step()
    yield from input_cases.strange_samples()
    yield from input_cases.peer_frames()


def chapters() -> tuple[Chapter, Chapter]:
    """Run every case, by tick rate and others; takes some seconds."""
    rates, results = measure(), list(case_results())
    count = Counter(result.verdict for result in results)
    counts = ", ".join(f"{count[each]} {IN_WORDS[each]}" for each in CaseVerdict if count[each])
    defects = [
        f"{result.run} ({result.verdict})"
        for result in results
        if result.verdict in (CaseVerdict.FAILS, CaseVerdict.WRONG)
    ]
    fate = f"Defects: {'; '.join(defects)}." if defects else "No case fails or is silently wrong."
    finding = f"Of {len(results)} hard cases for the force loop, {counts}. {fate}"
    rates_summary = _rates_summary(rates)
    cases = Table(
        "Hard cases",
        ("case", "what was run", "verdict", "figure", "why"),
        [(one.case, one.run, str(one.verdict), one.figure, one.reason) for one in results],
        summary=f"{finding} All are in the page written to --out.",
    )
    method = (
        "Every case runs the display's own code: the force loop between Safety and the film, or"
        " its models. A verdict is computed from the run. Stable: the felt force is finite, never"
        f" beyond {BOUND_N:g} N, and in the end within the force of one microstep (with the paper's"
        " actuator, eq 22: 1 %) of the target, plus the error of the scene's film. Refused: an"
        " error with a reason, or a latched fault that brings the finger to rest. Limit cycle: more"
        " than the force of one microstep from peak to peak round a constant force. Fails with a"
        " named reason: an unforeseen error, or a latched fault after which the felt force rises,"
        " leaves the bounds or does not come to rest. Silently wrong: everything else."
    )
    caption = (
        "The paper's gains in mV by eq 21 over the tick rate, derivative without a filter. The"
        " explicit PID is stable where its largest pole is below 1; elsewhere it has no RMSE."
    )
    plot = Plot("stability", caption, lambda figure: _draw_rates(figure, rates))
    return (
        Chapter(
            "Numerical stability over the tick rate",
            (rates_summary,),
            (_rates_table(rates, rates_summary),),
            (plot,),
        ),
        Chapter("Hard cases", (method,), (cases,), findings=(finding,), folded=True),
    )
