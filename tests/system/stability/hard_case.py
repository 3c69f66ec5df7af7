"""A hard case for the shipped force loop: its run, and the verdict on it.

The verdict is computed from the felt force, from the fault that Safety reports, or from the
SceneError of a refused loop. A case does not state an expected verdict.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from display_node.control.safety import ForceBounds, Safety
from display_node.scene import DisplayScene
from protocol.config.scene_file import find_scene
from protocol.errors import SceneError
from protocol.tactile import Adc
from telepulse.paper import published
from telepulse.paper.stability import BOUND_N, HELD_N, SAFETY, Array, paper_setup
from telepulse.paper.stepper import refusal_reason
from telepulse.scene import load_scene

SceneTable = Mapping[str, object]
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
    """What was run, the verdict, and its reason; a stable loop needs none.

    felt_n: felt force in N at the end of each tick; None if the loop did not run.
    """

    case: str
    run: str
    verdict: CaseVerdict
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


@dataclass(frozen=True, slots=True)
class HardCase:
    """A case to run and to judge by the felt force.

    reference: target force in N at a tick. reading: of the film for the controller in N, from the
    tick and the film's own. with_safety: Safety bounds both. target_n, tolerance_microsteps: final
    target force, and distance from it within which a stepper has settled. disturbance_tick: its
    tick.
    """

    case: str
    name: str
    setup: DisplayScene
    reference: Callable[[int], float] = lambda _: HELD_N
    reading: Callable[[int, float], float] = lambda _, reading_n: reading_n
    with_safety: bool = True
    ticks: int = 2000
    target_n: float = HELD_N
    tolerance_microsteps: float = 1.0
    disturbance_tick: int = 0

    def run(self) -> tuple[Array, list[str]]:
        """Run the loop from rest as the display does, tick by tick. Raises SceneError.

        Returns the felt force in N at each tick's end, and the faults that Safety reported.
        """
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
        return np.array(felt_n), safety.faults


def evaluate(case: HardCase) -> CaseResult:
    """Run a case and judge it."""
    try:
        felt_n, faults = case.run()
    except SceneError as error:
        return CaseResult(case.case, case.name, CaseVerdict.REFUSED, refusal_reason(error))
    except Exception as error:  # a defect of the loop
        reason = f"{type(error).__name__}: {error}"
        return CaseResult(case.case, case.name, CaseVerdict.FAILS, reason)
    return CaseResult(case.case, case.name, *judge(case, felt_n, faults), felt_n)


def judge(case: HardCase, felt_n: Array, faults: list[str]) -> tuple[CaseVerdict, str]:
    """Return the verdict on a run, and its reason."""
    end_n = felt_n[-len(felt_n) // 4 :]
    defect = CaseVerdict.FAILS if faults else CaseVerdict.WRONG
    fault = f", in spite of the fault: {faults[0]}" if faults else ""
    if not np.isfinite(felt_n).all():
        return defect, f"the felt force is not a number{fault}"
    if np.abs(felt_n).max() > BOUND_N:
        return defect, f"felt beyond {BOUND_N:g} N{fault}"
    if faults:
        # The force may rise for two ticks, at most at the slew limit: one until the drive has
        # the command, one until it reverses.
        slack_n = 2 * SAFETY.slew_limit_n_per_s * case.setup.tick_ns * 1e-9
        before_n = felt_n[max(case.disturbance_tick - 1, 0)]
        if felt_n[case.disturbance_tick :].max() > before_n + slack_n:
            return defect, f"presses harder{fault}"
        if np.abs(end_n).max() > AT_REST_N:
            return defect, f"does not come to rest{fault}"
        return CaseVerdict.REFUSED, f"at rest for good after the fault: {faults[0]}"
    low_n, high_n = settled_range_n(case.setup, case.target_n, case.tolerance_microsteps)
    if end_n.min() < low_n or end_n.max() > high_n:
        return CaseVerdict.WRONG, f"does not settle on {case.target_n:g} N"
    return CaseVerdict.STABLE, ""
