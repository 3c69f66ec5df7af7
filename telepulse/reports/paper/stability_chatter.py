"""Direction chatter: what a stepper's loop still does when it has settled on a constant force."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from display_node.plant.stepper import StepperScene
from telepulse.reports.paper.stability import (
    Array,
    Setup,
    StabilityOutcome,
    StabilityTrial,
    StabilityVerdict,
    Table,
    judged,
    newtons,
    ran,
    setup,
    shipped,
)
from telepulse.reports.paper.stability_loops import (
    FED,
    ON_FORCE,
    ON_POSITION,
    RIGID,
    SLOW_FILM,
    STEPPER,
    WITH_INTEGRAL,
)

# About halfway between two microsteps of the scenes' steppers.
BETWEEN_N = 0.3003
# A cycle of so many microsteps is told as a cycle, not as a loop that does not settle.
CHATTER_REACH = 20.0
TICKS = 4000
ROUNDING_N = 1e-12
SCENES = ("radial", "conditioned", "bench", "real_bench")


@dataclass(frozen=True, slots=True)
class Chatter:
    """At rest on a constant reference: travel of the felt force from peak to peak in
    microsteps, reversals of its direction in 1/s."""

    microsteps: float
    reversals_hz: float
    peak_to_peak_n: float


def chatter(loop: Setup, felt_n: Array) -> Chatter:
    """What is left of a run when a stepper's loop has settled: its second half."""
    assert isinstance(loop.actuator, StepperScene), "microsteps are a stepper's"
    felt_n = felt_n[len(felt_n) // 2 :]
    law = loop.actuator.contact(loop.layer)
    travel_m = law.position(float(felt_n.max())) - law.position(float(felt_n.min()))
    moves = np.diff(felt_n)
    ways = np.sign(moves[np.abs(moves) > ROUNDING_N])
    reversals = int(np.count_nonzero(np.diff(ways)))
    return Chatter(
        travel_m / loop.actuator.step_m,
        reversals / (len(felt_n) * loop.tick_s),
        float(np.ptp(felt_n)),
    )


def direction_chatter() -> Iterator[StabilityOutcome]:
    """Round zero error, between two microsteps, without a dead band and with one."""
    rotor: Table = {**STEPPER, "rotor_resonance": "100 Hz"}
    coarse: Table = {"adc_bits": 16, "sensitivity": "44 mV/N"}
    noisy: Table = {"noise": "1 mN"}
    cases: tuple[tuple[str, Table, Table, Table | None, float], ...] = (
        ("kp = 300", ON_POSITION, STEPPER, None, 0.6),
        ("rigid stop, kp = 300", ON_POSITION, RIGID, None, 0.6),
        ("error in force, kp = 0.1", ON_FORCE, STEPPER, None, 0.6),
        ("ki = 1000", WITH_INTEGRAL, STEPPER, None, 0.6),
        ("rotor at 100 Hz, ζ = 0.2", FED, rotor, None, 1.5),
        ("rotor at 100 Hz, film of 40 Hz", FED, rotor, SLOW_FILM, 0.6),
        ("film rounded to 6.9 mN", {**FED, "kp": 390}, STEPPER, coarse, 12.0),
        ("film noise of 1 mN", ON_POSITION, STEPPER, noisy, 12.0),
    )
    for name, controller, actuator, film, band in cases:
        for microsteps in (0.0, band):
            yield _chatters(name, controller, actuator, film, microsteps)
    for scene in SCENES:
        yield _still(f"scenes/{scene}.toml as shipped", shipped(scene))


def _chatters(
    name: str, controller: Table, actuator: Table, film: Table | None, microsteps: float
) -> StabilityOutcome:
    """A dead band of so many microsteps of error."""
    loop = setup(controller, actuator, film)
    stepper = loop.actuator
    assert isinstance(stepper, StepperScene), "chatter is a stepper's"
    per_step = stepper.step_m
    if loop.controller.error == "force":
        per_step *= stepper.contact(loop.layer).stiffness(BETWEEN_N)
    band = microsteps * per_step
    what = f"{name}, " + (f"dead band of {microsteps:g} microsteps" if band else "no dead band")
    quiet = replace(loop, controller=loop.controller.model_copy(update={"dead_band": band}))
    return _still(what, quiet)


def _still(what: str, loop: Setup) -> StabilityOutcome:
    trial = StabilityTrial(
        "direction chatter",
        what,
        loop,
        "at most the one microstep that lies across the force wanted",
        reference=lambda _: BETWEEN_N,
        target_n=BETWEEN_N,
        microsteps=CHATTER_REACH,
        ticks=TICKS,
    )
    done = ran(trial)
    if isinstance(done, StabilityOutcome):
        return done
    found = chatter(loop, done.felt_n)
    figure = (
        f"{found.microsteps:.2f} microsteps ({newtons(found.peak_to_peak_n)}) from peak to peak,"
        f" {found.reversals_hz:.0f} reversals/s"
    )
    outcome = replace(judged(trial, done), figure=figure)
    if outcome.verdict is not StabilityVerdict.STABLE or found.microsteps <= 1 + 1e-6:
        return outcome
    if loop.film.noise_n:
        return replace(outcome, reason="no cycle: it follows the film's noise")
    return replace(outcome, verdict=StabilityVerdict.CYCLES, reason="above one microstep")
