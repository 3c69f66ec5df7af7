"""Hard cases of the loop itself: contact, damping, ticks, saturation, chatter, a step."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from display_node.plant.second_order import SecondOrderScene
from protocol.config.scene import validate
from protocol.errors import SceneError
from protocol.tactile import ElasticLayer
from telepulse.reports.paper import numbers
from telepulse.reports.paper.stability import (
    HELD_N,
    TICK_S,
    Setup,
    StabilityOutcome,
    StabilityTrial,
    StabilityVerdict,
    Table,
    attempt,
    judged,
    newtons,
    ran,
    run,
    setup,
    shipped,
)
from telepulse.reports.paper.stability_rates import papers

STEPPER: Table = {"kind": "stepper"}
RIGID: Table = {"kind": "stepper", "fingertip": "1e9 N/m"}
SLOW_FILM: Table = {"filter": "40 Hz"}
STIFF = ElasticLayer(young_modulus_pa=5e9)
ON_FORCE: Table = {"kp": 0.1}
ON_POSITION: Table = {"kp": 300, "error": "position"}
WITH_INTEGRAL: Table = {"kp": 100, "ki": 1000, "error": "position"}
FED: Table = {"kp": 100, "error": "position", "feed_forward": True}
OBSERVED: Table = {**FED, "kp": 130, "observer": {"wander": "0.1 mm"}}
STEP_AT = 500
SWING_FROM, SWING_TO, SWING_HZ = 500, 1500, 5.0
# An integral settles with ki / kp = 5 /s: 2 s leave e^−10.
SETTLING = 4000
STEP_TO_N = HELD_N + 1.0
SLOW_M_PER_S = 2e-3


def stiff_contact() -> Iterator[StabilityOutcome]:
    """A rigid stop, a layer of 5 GPa, and both, with the film as it is and with its filter."""
    for contact, actuator, layer in (
        ("rigid stop", RIGID, numbers.LAYER),
        ("E = 5 GPa", STEPPER, STIFF),
        ("rigid stop, E = 5 GPa", RIGID, STIFF),
    ):
        for seen, film in (("film as it is", None), ("film of 40 Hz", SLOW_FILM)):
            for law, controller in (("force", ON_FORCE), ("position", ON_POSITION)):
                yield attempt(
                    StabilityTrial(
                        "stiff contact",
                        f"{contact}, {seen}, error in {law}, kp = {controller['kp']}",
                        setup(controller, actuator, film, layer),
                        "within a microstep of the force wanted; the PID knows the contact's"
                        " stiffness and solves for the tick's end",
                    )
                )
    yield attempt(
        StabilityTrial(
            "stiff contact",
            "rigid stop, E = 5 GPa, film of 40 Hz and 4 poles, error in force, kp = 10",
            setup({"kp": 10}, {**RIGID, "lead": "0.1 mm"}, {**SLOW_FILM, "filter_order": 4}, STIFF),
        )
    )


def nearly_undamped() -> Iterator[StabilityOutcome]:
    """Eq 22 without c, and a rotor that rings for ever."""
    experiment = papers(numbers.EXPERIMENT, 200.0, TICK_S)
    proportional: Table = {"kp": 15, "error": "force"}
    for c in (0.0, 1e-9):
        damped = numbers.ACTUATOR.model_copy(update={"c": c})
        yield attempt(
            StabilityTrial(
                "nearly undamped",
                f"eq 22, c = {c:g}, the experiment's gains on mV",
                replace(experiment, actuator=damped),
                "the derivative damps it",
            )
        )
        bare = replace(setup(proportional, {"kind": "second_order"}), actuator=damped)
        yield attempt(
            StabilityTrial("nearly undamped", f"eq 22, c = {c:g}, proportional on N, kp = 15", bare)
        )
    for damping in (0.2, 1e-6, 0.0):
        rotor: Table = {**STEPPER, "rotor_resonance": "100 Hz", "rotor_damping": damping}
        for name, controller in (("kp = 10", {**FED, "kp": 10}), ("observer", OBSERVED)):
            yield attempt(
                StabilityTrial(
                    "nearly undamped",
                    f"rotor at 100 Hz, ζ = {damping:g}, position with {name}",
                    setup(controller, rotor),
                    "the gain is below 2 ζ ω of the rotor, or the observer knows the rotor",
                )
            )
    yield _massless(experiment)


def _massless(loop: Setup) -> StabilityOutcome:
    case, what = "vanishing mass", "eq 22 with m = 1e-300"
    try:
        massless = validate({"kind": "second_order", "m": 1e-300}, SecondOrderScene, "actuator:")
    except SceneError as error:
        return StabilityOutcome(case, what, StabilityVerdict.REFUSED, "–", str(error))
    return attempt(
        StabilityTrial(case, what, replace(loop, actuator=massless), "as any other mass")
    )


def extreme_ticks() -> Iterator[StabilityOutcome]:
    """The loops at 1 µs and at 100 ms a tick."""
    loops = {
        "the experiment's gains on eq 22": papers(numbers.EXPERIMENT, 200.0, TICK_S),
        "scenes/bench.toml": shipped("bench"),
        "scenes/real_bench.toml": shipped("real_bench"),
    }
    for told, tick_s, ticks in (("1 µs", 1e-6, 60_000), ("100 ms", 0.1, 400)):
        for name, loop in loops.items():
            yield attempt(
                StabilityTrial(
                    "extreme ticks",
                    f"{name}, ticks of {told}",
                    replace(loop, tick_s=tick_s),
                    "hold and filters are exact at any tick; integral and derivative are backward"
                    " Euler",
                    ticks=ticks,
                )
            )


def saturated_steps() -> Iterator[StabilityOutcome]:
    """A reference that swings faster than the drive can go, then holds."""
    for name, controller in (
        ("position with ki = 500", {**WITH_INTEGRAL, "ki": 500}),
        ("force with ki = 0.5", {"kp": 0.1, "ki": 0.5}),
        ("feed-forward", FED),
    ):
        for fine, drive in (
            ("1/16 of 2 mm", STEPPER),
            ("1/256 of 1 mm", {**STEPPER, "microsteps": 256, "lead": "1 mm"}),
        ):
            fast = setup(controller, drive)
            slow = setup(controller, {**drive, "max_speed": f"{SLOW_M_PER_S} m/s"})
            yield _wound_up(f"{name}, microsteps {fine}", slow, fast)


def _swing(tick: int) -> float:
    if not SWING_FROM <= tick < SWING_TO:
        return HELD_N
    turns = SWING_HZ * TICK_S * (tick - SWING_FROM)
    return HELD_N + 1.0 + 0.9 * math.sin(2 * math.pi * turns)


def _wound_up(what: str, slow: Setup, fast: Setup) -> StabilityOutcome:
    """An integral that had gone on in saturation would undershoot further than one without."""
    trial = StabilityTrial(
        "saturated step rate",
        f"{what}, at most {1e3 * SLOW_M_PER_S:g} mm/s",
        slow,
        "the integral stands still in saturation",
        reference=_swing,
        ticks=SWING_TO + SETTLING,
    )
    done = ran(trial)
    if isinstance(done, StabilityOutcome):
        return done
    under_n, free_n = (
        HELD_N - float(each.felt_n[SWING_TO:].min())
        for each in (done, run(fast, trial.ticks, _swing))
    )
    figure = f"undershoot {newtons(under_n)}, {newtons(free_n)} with 400 mm/s"
    outcome = replace(judged(trial, done), figure=figure)
    microstep_n = HELD_N - slow.around(HELD_N)[0]
    if outcome.verdict is StabilityVerdict.STABLE and under_n > free_n + microstep_n:
        return replace(outcome, verdict=StabilityVerdict.WRONG, reason="winds up")
    return outcome


def force_step() -> Iterator[StabilityOutcome]:
    """A step of 1 N, through Safety as in a display, and without."""
    loops = {
        "the experiment's gains on eq 22": papers(numbers.EXPERIMENT, 200.0, TICK_S),
        "scenes/bench.toml": shipped("bench"),
        "scenes/real_bench.toml": shipped("real_bench"),
        "PID on force": setup({"kp": 0.1, "ki": 0.5, "kd": 1e-4}, STEPPER),
    }
    for name, loop in loops.items():
        for safe in (True, False):
            yield _stepped(f"{name}, {'through' if safe else 'without'} Safety", loop, safe)


def _stepped(what: str, loop: Setup, safe: bool) -> StabilityOutcome:
    trial = StabilityTrial(
        "a step of 1 N",
        what,
        loop,
        "Safety's slew limit makes a ramp of it" if safe else "as steep as the loop will go",
        reference=lambda tick: STEP_TO_N if tick >= STEP_AT else HELD_N,
        safe=safe,
        target_n=STEP_TO_N,
        ticks=STEP_AT + SETTLING,
    )
    done = ran(trial)
    if isinstance(done, StabilityOutcome):
        return done
    felt_n = done.felt_n[STEP_AT - 1 :]
    off = np.flatnonzero(np.abs(felt_n - STEP_TO_N) > 0.02)
    fastest = float(np.diff(felt_n).max()) / loop.tick_s
    figure = (
        f"overshoot {100 * (float(felt_n.max()) - STEP_TO_N):.1f} %, within 2 % after"
        f" {1e3 * loop.tick_s * (int(off[-1]) + 1):.0f} ms, at most {fastest:.0f} N/s"
    )
    return replace(judged(trial, done), figure=figure)
