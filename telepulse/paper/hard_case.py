"""Hard cases for the shipped force loop: a case, its run, and the verdict on it.

The verdict is computed from the felt force, from the fault that Safety reports, or from the
SceneError of a refused loop. A case does not state an expected verdict.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.control.safety import ForceBounds, Safety
from display_node.control.scene import SafetyScene
from display_node.scene import DisplayScene
from protocol.config.scene_file import find_scene
from protocol.errors import SceneError
from protocol.tactile import Adc
from telepulse.paper import published
from telepulse.paper.published import Gains
from telepulse.scene import load_scene

Array = NDArray[np.float64]
SceneTable = Mapping[str, object]
# Force to hold: a typical mean of a pulse.
HELD_N = 0.3
# The shortest ramp, so that it does not hide what the loop itself does.
SAFETY = SafetyScene.model_validate({"ramp": "1 ms"})
# Felt force beyond this, pressing or pulling, is out of bounds: the fault level of Safety.
BOUND_N = SAFETY.force_limit_n * SAFETY.overforce
# The paper's actuator (eq 22) has no microsteps; it has settled within this share of the force.
SETTLED_SHARE = 0.01
# Standard deviations of the film's noise that are allowed for.
NOISE_DEVIATIONS = 4.0
# Below this the force counts as 0.
AT_REST_N = 1e-3


class CaseVerdict(StrEnum):
    """Verdict on a hard case. The last two are defects, the last one the worst.

    REFUSED: not started, or at rest after a fault that Safety has latched. FAILS: an unforeseen
    error, or a latched fault after which the force rises, leaves the bounds or does not rest.
    """

    STABLE = "stable"
    REFUSED = "refused"
    CYCLES = "limit cycle"
    FAILS = "fails with a named reason"
    WRONG = "silently wrong"


class CaseResult(NamedTuple):
    """A row of the report: what was run, the verdict, and the measured value that supports it.

    felt_n: felt force in N at the end of each tick; None if the loop did not run.
    """

    case: str
    run: str
    verdict: CaseVerdict
    figure: str
    reason: str
    felt_n: Array | None = None


def make_setup(
    controller: SceneTable,
    actuator: SceneTable,
    film: SceneTable | None = None,
    layer: SceneTable | None = None,
) -> DisplayScene:
    """Make a display from tables as a scene has them; the layer is Table 3's by default."""
    tables = {"controller": controller, "actuator": actuator, "film": film or {}}
    return DisplayScene.model_validate(tables | {"layer": layer or {}, "safety": SAFETY})


def scene_setup(name: str) -> DisplayScene:
    """Return the display of a shipped scene, with the shortest ramp."""
    return load_scene(find_scene(name)).display.model_copy(update={"safety": SAFETY})


def paper_setup(gains: Gains, filter_hz: float = 200.0, tick_s: float = 1e-3) -> DisplayScene:
    """Return the paper's loop as the display runs it: error in mV (eq 21), actuator eq 22."""
    table = {"error": "millivolts", "derivative_filter": f"{filter_hz} Hz", **gains._asdict()}
    return with_tick(make_setup(table, dict(published.ACTUATOR)), tick_s)


def with_tick(setup: DisplayScene, tick_s: float) -> DisplayScene:
    """Return a display with another tick, which need not be one that a scene may have."""
    return setup.model_copy(update={"tick_ns": round(1e9 * tick_s)})


def common_setups() -> dict[str, DisplayScene]:
    """Return the displays that most cases share, by name."""
    return {
        "the experiment's gains on eq 22": paper_setup(published.EXPERIMENT),
        "scenes/bench.toml": scene_setup("bench"),
        "scenes/real_bench.toml": scene_setup("real_bench"),
    }


def settled_range_n(
    setup: DisplayScene, force_n: float, microsteps: float = 1.0
) -> tuple[float, float]:
    """Return the least and greatest force in N at which a loop has settled on `force_n`.

    A stepper: within `microsteps` and the dead band, plus noise and quantisation of the film.
    The paper's actuator: within 1 %.
    """
    actuator, controller, film = setup.actuator, setup.controller, setup.film
    if (stepper := actuator.stepper) is None:
        return (1 - SETTLED_SHARE) * force_n, (1 + SETTLED_SHARE) * force_n
    law = stepper.contact(setup.layer.layer())
    x_m, step_m = law.position(force_n), microsteps * stepper.step_m
    error_per_m = 1.0
    if controller.error != "position":
        error_per_m = controller.error_per_newton(film) * law.stiffness(force_n)
    step_m += controller.dead_band / error_per_m
    off_n = NOISE_DEVIATIONS * film.noise_n
    if film.adc_bits is not None:
        off_n += Adc(film.adc_bits, film.adc_range_v).step_volts / film.volts_per_newton
    rounding_m = 1e-9 * (x_m + step_m)
    low_n = law.force(x_m - step_m - rounding_m)
    return low_n - off_n, law.force(x_m + step_m + rounding_m) + off_n


class CaseRun(NamedTuple):
    """Felt force in N at each tick's end, and the faults that Safety reported."""

    felt_n: Array
    faults: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class HardCase:
    """A case to run and to judge by the felt force.

    Attributes
    ----------
    explanation
        Reason printed with the verdict STABLE; the others take theirs from the run.
    reference
        Returns the target force in N at a tick.
    reading
        Returns the reading in N for the controller, from the tick and the film's own reading.
    with_safety
        Safety bounds the reference and checks the reading.
    target_n, tolerance_microsteps
        Final target force, and distance from it within which a stepper has settled.
    ticks
        Length of the run.
    disturbance_tick
        Tick of the disturbance.
    """

    case: str
    name: str
    setup: DisplayScene
    explanation: str = ""
    reference: Callable[[int], float] = lambda _: HELD_N
    reading: Callable[[int, float], float] = lambda _, reading_n: reading_n
    with_safety: bool = True
    ticks: int = 2000
    target_n: float = HELD_N
    tolerance_microsteps: float = 1.0
    disturbance_tick: int = 0

    def run(self) -> CaseRun:
        """Run the loop from rest as the display does, tick by tick. Raises SceneError."""
        loop, tick_ns = self.setup.force_loop(), self.setup.tick_ns
        safety, bounds = Safety(SAFETY, tick_ns), ForceBounds(SAFETY, tick_ns)
        reach, felt_n = range(loop.horizon + 1), []
        for tick in range(self.ticks):
            wanted_n = [self.reference(tick + ahead) for ahead in reach]
            reading_n = self.reading(tick, loop.read_film())
            if self.with_safety:
                if (fault := bounds.reading_fault(reading_n)) is not None:
                    safety.fault(fault)
                wanted_n = bounds.bound(wanted_n, safety.advance(alive=True))
            felt_n.append(loop.tick(wanted_n, reading_n))
        return CaseRun(np.array(felt_n), tuple(safety.faults))


def evaluate(case: HardCase) -> CaseResult:
    """Run a case and judge it."""
    try:
        run = case.run()
    except SceneError as error:
        return CaseResult(case.case, case.name, CaseVerdict.REFUSED, "–", refusal_reason(error))
    except Exception as error:  # a defect of the loop, which must not end the report
        reason = f"{type(error).__name__}: {error}"
        return CaseResult(case.case, case.name, CaseVerdict.FAILS, "–", reason)
    verdict, reason = judge(case, run)
    # The distance from the target at the end, and the extremes since the disturbance, if any.
    final_error_n = np.abs(run.felt_n[-len(run.felt_n) // 4 :] - case.target_n).max()
    since_n = run.felt_n[case.disturbance_tick :]
    figure = f"{force_text(float(final_error_n))} off, at most {force_text(float(since_n.max()))}"
    if case.disturbance_tick or since_n.min() < 0:
        figure += f", at least {force_text(float(since_n.min()))}"
    return CaseResult(case.case, case.name, verdict, figure, reason, run.felt_n)


def judge(case: HardCase, run: CaseRun) -> tuple[CaseVerdict, str]:
    """Return the verdict on a run, and its reason."""
    felt_n = run.felt_n
    end_n = felt_n[-len(felt_n) // 4 :]
    defect = CaseVerdict.FAILS if run.faults else CaseVerdict.WRONG
    fault = f", in spite of the fault: {run.faults[0]}" if run.faults else ""
    if not np.isfinite(felt_n).all():
        return defect, f"the felt force is not a number{fault}"
    if np.abs(felt_n).max() > BOUND_N:
        return defect, f"felt beyond {BOUND_N:g} N{fault}"
    if run.faults:
        # The force may rise for two ticks, at most at the slew limit: one until the drive has
        # the command, one until it reverses.
        slack_n = 2 * SAFETY.slew_limit_n_per_s * case.setup.tick_ns * 1e-9
        before_n = felt_n[max(case.disturbance_tick - 1, 0)]
        if felt_n[case.disturbance_tick :].max() > before_n + slack_n:
            return defect, f"presses harder{fault}"
        if np.abs(end_n).max() > AT_REST_N:
            return defect, f"does not come to rest{fault}"
        return CaseVerdict.REFUSED, f"at rest for good after the fault: {run.faults[0]}"
    low_n, high_n = settled_range_n(case.setup, case.target_n, case.tolerance_microsteps)
    if end_n.min() < low_n or end_n.max() > high_n:
        return CaseVerdict.WRONG, f"does not settle on {case.target_n:g} N"
    return CaseVerdict.STABLE, case.explanation


def refusal_reason(error: Exception) -> str:
    """Return the reason in an error's text, without the leading key and the trailing advice."""
    return str(error).removeprefix("[display] controller: ").split(": lower its")[0]


def force_text(force_n: float) -> str:
    """Return a force as text, in mN below 1 N."""
    if not math.isfinite(force_n):
        return "not a number"
    return f"{1e3 * force_n:.3g} mN" if abs(force_n) < 0.9995 else f"{force_n:.3g} N"
