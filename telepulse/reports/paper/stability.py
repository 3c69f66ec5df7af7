"""Hard cases for the shipped force loop: how one is run, and how its outcome is judged.

A verdict is computed from what is felt, from the fault that Safety names or from the error that
refuses the case; nothing here knows which verdict to expect.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from display_node.control.controller import ControllerScene
from display_node.control.force_loop import ForceLoop, build_force_loop
from display_node.control.safety import Safety, SafetyScene
from display_node.plant.film import FilmTable
from display_node.plant.second_order import SecondOrderScene
from display_node.plant.stepper import StepperScene
from protocol.calibration import Adc
from protocol.errors import SceneError
from protocol.tactile import ElasticLayer
from telepulse.reports.paper import numbers
from telepulse.scene import find_scene, load_scene

Array = NDArray[np.float64]
Table = Mapping[str, object]
TICK_S = 1e-3
PLAIN_FILM = FilmTable()
# A pulse's usual mean.
HELD_N = 0.3
# The shortest ramp, lest it hide what the loop itself does.
SAFETY = SafetyScene.model_validate({"ramp": "1 ms"})
# Felt force beyond this, pressing or pulling, is out of bounds: the fault level of Safety.
BOUND_N = SAFETY.force_limit_n * SAFETY.overforce
# Eq 22 has no microsteps: this share of the force wanted stands for one.
SETTLED_SHARE = 0.01
NOISE_REACH = 4.0
AT_REST_N = 1e-3


class StabilityVerdict(StrEnum):
    """What became of a case. The last three are defects, the last one the worst."""

    STABLE = "stable"
    REFUSED = "refused"
    CYCLES = "limit cycle"
    FAILS = "fails, and says so"
    WRONG = "silently wrong"


@dataclass(frozen=True, slots=True)
class StabilityOutcome:
    """A row of the report: what was run, what became of it, the figure that proves it."""

    case: str
    run: str
    verdict: StabilityVerdict
    figure: str
    reason: str


@dataclass(frozen=True, slots=True)
class Setup:
    """The parts of a force loop."""

    controller: ControllerScene
    actuator: SecondOrderScene | StepperScene
    film: FilmTable = PLAIN_FILM
    layer: ElasticLayer = numbers.LAYER
    tick_s: float = TICK_S

    def loop(self) -> ForceLoop:
        """The loop as a display builds it. Raises SceneError."""
        return build_force_loop(
            self.controller,
            self.actuator,
            self.layer,
            self.film,
            SAFETY.force_limit_n,
            self.tick_s,
            slew_limit_n_per_s=SAFETY.slew_limit_n_per_s,
        )

    def around(self, force_n: float, microsteps: float = 1.0) -> tuple[float, float]:
        """The forces in N between which this loop has settled on `force_n`.

        So many microsteps and the dead band to either side, and what the film's reading is off
        by; on eq 22, 1 %.
        """
        if isinstance(self.actuator, SecondOrderScene):
            return (1 - SETTLED_SHARE) * force_n, (1 + SETTLED_SHARE) * force_n
        law, film = self.actuator.contact(self.layer), self.film
        x_m, step_m = law.position(force_n), microsteps * self.actuator.step_m
        per_m = law.stiffness(force_n) if self.controller.error == "force" else 1.0
        step_m += self.controller.dead_band / per_m
        off_n = NOISE_REACH * film.noise_n
        if film.adc_bits is not None:
            off_n += Adc(film.adc_bits, film.adc_range_v).step_volts / film.volts_per_newton
        rounding_m = 1e-9 * (x_m + step_m)
        low_n = law.force(x_m - step_m - rounding_m)
        return low_n - off_n, law.force(x_m + step_m + rounding_m) + off_n


def setup(
    controller: Table,
    actuator: Table,
    film: Table | None = None,
    layer: ElasticLayer = numbers.LAYER,
    tick_s: float = TICK_S,
) -> Setup:
    """A setup from tables as a scene has them."""
    kind = StepperScene if actuator["kind"] == "stepper" else SecondOrderScene
    return Setup(
        ControllerScene.model_validate(controller),
        kind.model_validate(actuator),
        FilmTable.model_validate(film or {}),
        layer,
        tick_s,
    )


def shipped(name: str) -> Setup:
    """The display's parts of a shipped scene."""
    display = load_scene(find_scene(name)).display
    return Setup(
        display.controller,
        display.actuator,
        display.film,
        display.layer.layer(),
        display.tick_ns * 1e-9,
    )


@dataclass(frozen=True, slots=True)
class StabilityRun:
    """Felt force in N at each tick's end, and the faults that Safety named."""

    felt_n: Array
    faults: tuple[str, ...]


def hold(_: int) -> float:
    """The reference of most cases."""
    return HELD_N


def as_read(_: int, reading_n: float) -> float:
    """The film's reading, left alone."""
    return reading_n


def run(
    setup: Setup,
    ticks: int,
    reference: Callable[[int], float] = hold,
    reading: Callable[[int, float], float] = as_read,
    safe: bool = True,
) -> StabilityRun:
    """Run a loop from rest as the display does, tick by tick.

    reference: force wanted in N at a tick; reading: what is made of the film's reading at a
    tick; safe: with Safety between reference and loop. Raises SceneError for a loop that is
    refused.
    """
    loop, safety = setup.loop(), Safety(SAFETY, round(setup.tick_s * 1e9))
    reach, felt_n = range(loop.horizon + 1), []
    for tick in range(ticks):
        wanted_n = [reference(tick + ahead) for ahead in reach]
        reading_n = reading(tick, loop.read_film())
        if safe:
            safety.watch(reading_n)
            wanted_n = safety.bound(wanted_n, alive=True)
        felt_n.append(loop.tick(wanted_n, reading_n))
    return StabilityRun(np.array(felt_n), tuple(safety.faults))


@dataclass(frozen=True, slots=True)
class StabilityTrial:
    """A case to run and judge by what is felt.

    target_n: force wanted in the end; microsteps: how far from it a stepper may settle; since:
    the tick of the disturbance; why: said of it when it is stable, for any other verdict has its
    own reason.
    """

    case: str
    what: str
    setup: Setup
    why: str = ""
    reference: Callable[[int], float] = hold
    reading: Callable[[int, float], float] = as_read
    safe: bool = True
    ticks: int = 2000
    target_n: float = HELD_N
    microsteps: float = 1.0
    since: int = 0


def attempt(trial: StabilityTrial) -> StabilityOutcome:
    """Run a trial and judge it."""
    done = ran(trial)
    return done if isinstance(done, StabilityOutcome) else judged(trial, done)


def ran(trial: StabilityTrial) -> StabilityRun | StabilityOutcome:
    """Run a trial; its outcome already, when there is an error instead of a run."""
    try:
        return run(trial.setup, trial.ticks, trial.reference, trial.reading, trial.safe)
    except SceneError as error:
        return StabilityOutcome(
            trial.case, trial.what, StabilityVerdict.REFUSED, "–", refusal(error)
        )
    except Exception as error:  # an error that helps nobody is a finding, not a crash of ours
        reason = f"{type(error).__name__}: {error}"
        return StabilityOutcome(trial.case, trial.what, StabilityVerdict.FAILS, "–", reason)


def judged(trial: StabilityTrial, done: StabilityRun) -> StabilityOutcome:
    """A trial's outcome from its run."""
    verdict, reason = judge(trial, done)
    return StabilityOutcome(trial.case, trial.what, verdict, figure(trial, done), reason)


def judge(trial: StabilityTrial, done: StabilityRun) -> tuple[StabilityVerdict, str]:
    """The verdict on a run, and its reason."""
    felt_n = done.felt_n
    end_n = felt_n[-len(felt_n) // 4 :]
    broken = StabilityVerdict.FAILS if done.faults else StabilityVerdict.WRONG
    told = f", in spite of the fault: {done.faults[0]}" if done.faults else ""
    if not np.isfinite(felt_n).all():
        return broken, f"the felt force is no number{told}"
    if np.abs(felt_n).max() > BOUND_N:
        return broken, f"felt beyond {BOUND_N:g} N{told}"
    if done.faults:
        # The drive needs a tick to be told and one to turn, at no more than the slew limit.
        slack_n = 2 * SAFETY.slew_limit_n_per_s * trial.setup.tick_s
        if felt_n[trial.since :].max() > felt_n[max(trial.since - 1, 0)] + slack_n:
            return broken, f"presses harder{told}"
        if np.abs(end_n).max() > AT_REST_N:
            return broken, f"does not come to rest{told}"
        return StabilityVerdict.REFUSED, f"at rest for good after the fault: {done.faults[0]}"
    low_n, high_n = trial.setup.around(trial.target_n, trial.microsteps)
    if end_n.min() < low_n or end_n.max() > high_n:
        return StabilityVerdict.WRONG, f"does not settle on {trial.target_n:g} N"
    return StabilityVerdict.STABLE, trial.why


def figure(trial: StabilityTrial, done: StabilityRun) -> str:
    """How far from the target in the end, and the extremes since the disturbance."""
    off_n = np.abs(done.felt_n[-len(done.felt_n) // 4 :] - trial.target_n).max()
    since_n = done.felt_n[trial.since :]
    text = f"{newtons(float(off_n))} off, at most {newtons(float(since_n.max()))}"
    if trial.since or since_n.min() < 0:
        text += f", at least {newtons(float(since_n.min()))}"
    return text


def refusal(error: Exception) -> str:
    """The reason in an error's line, without the scene's key and the advice."""
    return str(error).removeprefix("[display] controller: ").split(": lower its")[0]


def newtons(force_n: float) -> str:
    """A force as people read it."""
    if not math.isfinite(force_n):
        return "no number"
    return f"{1e3 * force_n:.3g} mN" if abs(force_n) < 0.9995 else f"{force_n:.3g} N"
