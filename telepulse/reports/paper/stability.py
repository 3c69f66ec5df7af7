"""The chapter on numerical stability: hard cases, each stable or refused with a reason."""

from collections import Counter
from collections.abc import Iterator

from telepulse.reports.document import Chapter, Table
from telepulse.reports.paper import input_cases, loop_cases
from telepulse.reports.paper.hard_case import BOUND_N, CaseResult, CaseVerdict
from telepulse.reports.paper.tick_rates import measure, rates_plot, rates_summary, rates_table

COLUMNS = ("case", "what was run", "verdict", "figure", "why")
DEFECTS = (CaseVerdict.FAILS, CaseVerdict.WRONG)


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
    yield from input_cases.spikes()
    yield from input_cases.not_forces()
    yield from input_cases.peer_frames()


def chapter() -> Chapter:
    """Run every case; takes some seconds."""
    rates, results = measure(), tuple(case_results())
    summary = _summary(results)
    cases = Table(
        "Hard cases",
        COLUMNS,
        tuple(
            (each.case, each.run, str(each.verdict), each.figure, each.reason) for each in results
        ),
        summary=f"{summary} All are on the page.",
    )
    return Chapter(
        "Numerical stability on hard cases",
        (
            "Every case runs the display's own code: the force loop that it builds, between Safety"
            " and the film, or its models. A verdict is computed from the run. Stable: felt force"
            f" finite, never beyond {BOUND_N:g} N, and in the end within a microstep (on eq 22,"
            " 1 %) of the wanted force, plus the error of the scene's film. Refused: an error with"
            " a reason, or a fault that brings the finger to rest for good. Limit cycle: more than"
            " one microstep from peak to peak round a constant force. Fails with a named reason:"
            " an error or a fault without a usable message, or without coming to rest. Silently"
            " wrong: everything else.",
            rates_summary(rates),
            summary,
        ),
        (rates_table(rates), cases),
        (rates_plot(rates),),
    )


def _summary(results: tuple[CaseResult, ...]) -> str:
    count = Counter(result.verdict for result in results)
    counts = ", ".join(f"{count[verdict]} {verdict}" for verdict in CaseVerdict if count[verdict])
    defects = [result for result in results if result.verdict in DEFECTS]
    if not defects:
        return f"Of the other {len(results)} rows: {counts}. No case fails or is silently wrong."
    names = "; ".join(f"{result.run} ({result.verdict})" for result in defects)
    return f"Of the other {len(results)} rows: {counts}. Defects: {names}."
