"""The study of integrators as a report: speed against error, the frontier, harder plants."""

from telepulse.reports.document import Chapter, Plot, Report, Table
from telepulse.reports.studies.integrator_scores import (
    CHECK_SUBSTEPS,
    CONTROL,
    DIGITS,
    MORE_DIGITS,
    ROTOR_HZ,
    ROTOR_TICKS_S,
    TICK_S,
    IntegratorEffort,
    IntegratorScores,
    LoopScores,
    loop_radius,
    table_4,
)
from telepulse.reports.studies.work_precision import ROUNDING, beaten_by, draw, verdict

NOT_INSTALLED = "not installed: pip install 'telepulse[bench]'"
# Further from the truth than this many times the pulse, a trajectory has left it for good.
GROWN = 10.0


def report_integrators(scores: IntegratorScores, effort: IntegratorEffort) -> Report:
    """The report on scores that took this effort."""
    return Report(
        "Integrators: speed against error on the paper's loop",
        (_loop_chapter(scores, effort), _rotor_chapter(scores, effort)),
    )


def _loop_chapter(scores: IntegratorScores, effort: IntegratorEffort) -> Chapter:
    points, default = scores.loop.points, scores.loop.points[0]
    radius = loop_radius(table_4(), TICK_S)
    return Chapter(
        "The paper's loop",
        (
            verdict(default, points),
            f"The paper's pulse for {effort.seconds:g} s, the experiment's gains of Table 5 (on the"
            " error in millivolts by eq 21, its derivative filtered), the actuator of eq 22 with"
            f" Table 4. The controller's tick is {TICK_S * 1e3:g} ms and the voltage is held over"
            " it. Integral, derivative and filter are discretised by backward Euler, which leaves"
            f" the closed loop a spectral radius of {radius:.6f}:"
            f" {'stable' if radius < 1 else 'unstable'}.",
            "The pulse is counted from its first sample, so that the loop begins at rest: a step at"
            " the start would be all that errors show. Every integrator steps the actuator inside"
            " the closed loop, with the same controller. Error: largest difference in force from"
            " the reference, over the pulse's peak to peak. Cost: processor time of the actuator's"
            " step alone, without the controller and in one thread, on the voltages of the loop's"
            f" first beat; median of {effort.rounds} rounds taken in turns.",
            "Where all voltages are known beforehand, one call of lsim for the whole run costs"
            f" {scores.loop.whole_us:.2g} µs a tick; a loop cannot be closed that way.",
        ),
        (_points_table(scores), _reference_table(scores.loop)),
        (
            Plot(
                "work-precision",
                "Largest error against cost of a step. The star is the default; libraries are"
                " hollow; in the shaded band, errors are rounding and count as equal.",
                lambda figure: draw(figure, points, default),
            ),
        ),
    )


def _points_table(scores: IntegratorScores) -> Table:
    points, default = scores.loop.points, scores.loop.points[0]
    rows = [
        (
            point.name,
            f"{point.error:.1e}",
            f"{point.cost_us:.2f}",
            f"{point.cost_us / default.cost_us:.1f}",
            "" if beaten_by(point, points) else "yes",
        )
        for point in points
    ]
    if not scores.has_control:
        rows.append((f"{CONTROL}: {NOT_INSTALLED}", "", "", "", ""))
    return Table(
        "Speed against error",
        ("integrator", "error", "µs a step", "× default", "frontier"),
        tuple(rows),
        f"{verdict(default, points)} × n: n sub-steps a tick. On the frontier: no other row"
        f" is both as accurate and as fast, where errors below {ROUNDING:g} are rounding and count"
        " as equal.",
    )


def _reference_table(scores: LoopScores) -> Table:
    return Table(
        "How sure the reference is",
        ("the whole loop in exact zero-order hold and decimals", "difference"),
        (
            (f"{DIGITS} digits, against {MORE_DIGITS} digits", f"{scores.digits_error:.1e}"),
            (
                f"{DIGITS} digits, against RK4 with {CHECK_SUBSTEPS} sub-steps in {DIGITS} digits",
                f"{scores.method_error:.1e}",
            ),
        ),
        "Over the pulse's peak to peak, as the errors above.",
    )


def _rotor_chapter(scores: IntegratorScores, effort: IntegratorEffort) -> Chapter:
    last_s = ROTOR_TICKS_S[-1]
    return Chapter(
        "Harder plants",
        (
            f"Eq 22 as a rotor that resonates at {ROTOR_HZ:g} Hz. A voltage of k times the pulse"
            f" is held over each tick for {effort.rotor_seconds:g} s, without a controller, so that"
            " what grows is the integrator's doing. (The paper's gains on the paper's plant have a"
            f" spectral radius of {loop_radius(table_4(), last_s):.2g} at a tick of"
            f" {last_s * 1e3:g} ms, with any integrator.)",
        ),
        tuple(
            Table(
                f"Error on a rotor with ζ = {damping:g}, by the tick",
                ("integrator", *(f"{tick_s * 1e3:g} ms" for tick_s in ROTOR_TICKS_S)),
                tuple((name, *map(_error_or_grows, row)) for name, row in errors.items()),
                f"grows: more than {GROWN:g} times the pulse away from the reference.",
            )
            for damping, errors in scores.rotors.items()
        ),
    )


def _error_or_grows(error: float) -> str:
    return "grows" if error > GROWN else f"{error:.1e}"
