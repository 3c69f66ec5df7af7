"""Hard cases of the loop: contact, damping, ticks, saturation, chatter, steps, hard inputs."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from typing import Any

from display_node.plant.scene import SecondOrderScene, StepperScene
from display_node.scene import DisplayScene
from protocol.config.scene import validate
from protocol.errors import SceneError
from telepulse.paper import published
from telepulse.paper.stability import HELD_N, Array, paper_setup
from tests.system.stability.hard_case import (
    CaseResult,
    CaseVerdict,
    HardCase,
    SceneTable,
    common_setups,
    evaluate,
    make_setup,
    scene_setup,
    settled_range_n,
)

STEPPER: SceneTable = {"kind": "stepper"}
RIGID: SceneTable = {"kind": "stepper", "fingertip": "1e9 N/m"}
SLOW_FILM: SceneTable = {"filter": "40 Hz"}
STIFF: SceneTable = {"young_modulus": "5e9 Pa"}
ON_FORCE: SceneTable = {"kp": 0.1}
ON_POSITION: SceneTable = {"kp": 300, "error": "position"}
WITH_INTEGRAL: SceneTable = {"kp": 100, "ki": 1000, "error": "position"}
FED: SceneTable = {"kp": 100, "error": "position", "feed_forward": True}
STEP_AT, STEP_TO_N = 500, HELD_N + 1.0
SWING_FROM, SWING_TO, SWING_HZ = 500, 1500, 5.0
# An integral settles with ki / kp = 5 /s: 2 s leave e^−10.
SETTLING = 4000
SLOW_M_PER_S = 2e-3
# About halfway between two microsteps of the scenes' steppers.
BETWEEN_N = 0.3003
# A cycle up to this size is reported as a cycle; a larger one means that the loop does not settle.
CHATTER_MICROSTEPS = 20.0
STRANGE_AT = 500


def stiff_contact() -> Iterator[CaseResult]:
    """Press on a rigid stop, a layer of 5 GPa, and both, with and without the film's filter."""
    case = "stiff contact"
    contacts = (
        ("rigid stop", RIGID, None),
        ("E = 5 GPa", STEPPER, STIFF),
        ("rigid stop, E = 5 GPa", RIGID, STIFF),
    )
    films = (("film as it is", None), ("film of 40 Hz", SLOW_FILM))
    controllers = (("force", ON_FORCE), ("position", ON_POSITION))
    for parts in product(contacts, films, controllers):
        (contact, actuator, layer), (film_name, film), (error, controller) = parts
        name = f"{contact}, {film_name}, error in {error}, kp = {controller['kp']}"
        yield evaluate(HardCase(case, name, make_setup(controller, actuator, film, layer)))
    name = "rigid stop, E = 5 GPa, film of 40 Hz and 4 poles, error in force, kp = 10"
    fine, slow_film = {**RIGID, "lead": "0.1 mm"}, {**SLOW_FILM, "filter_order": 4}
    yield evaluate(HardCase(case, name, make_setup({"kp": 10}, fine, slow_film, STIFF)))


def nearly_undamped() -> Iterator[CaseResult]:
    """Run eq 22 without damping, a rotor that rings without end, and eq 22 without mass."""
    case, experiment = "nearly undamped", paper_setup(published.EXPERIMENT)
    proportional = make_setup({"kp": 15, "error": "force"}, {"kind": "second_order"})
    for c in (0.0, 1e-9):
        damped = published.ACTUATOR.model_copy(update={"c": c})
        setup = experiment.model_copy(update={"actuator": damped})
        name = f"eq 22, c = {c:g}, the experiment's gains on mV"
        yield evaluate(HardCase(case, name, setup))
        name = f"eq 22, c = {c:g}, proportional on N, kp = 15"
        setup = proportional.model_copy(update={"actuator": damped})
        yield evaluate(HardCase(case, name, setup))
    observed = {**FED, "kp": 130, "observer": {"wander": "0.1 mm"}}
    controllers: dict[str, SceneTable] = {"kp = 10": {**FED, "kp": 10}, "observer": observed}
    for damping, (name, controller) in product((0.2, 1e-6, 0.0), controllers.items()):
        rotor: SceneTable = {**STEPPER, "rotor_resonance": "100 Hz", "rotor_damping": damping}
        name = f"rotor at 100 Hz, ζ = {damping:g}, position with {name}"
        yield evaluate(HardCase(case, name, make_setup(controller, rotor)))
    case, name = "vanishing mass", "eq 22 with m = 1e-300"
    try:
        massless = validate({"kind": "second_order", "m": 1e-300}, SecondOrderScene, "actuator:")
    except SceneError as error:
        yield CaseResult(case, name, CaseVerdict.REFUSED, str(error))
    else:
        setup = experiment.model_copy(update={"actuator": massless})
        yield evaluate(HardCase(case, name, setup))


def extreme_ticks() -> Iterator[CaseResult]:
    """Run the loops at 1 µs and at 100 ms a tick."""
    for tick, tick_s, ticks in (("1 µs", 1e-6, 120_000), ("100 ms", 0.1, 400)):
        for name, setup in common_setups().items():
            timed = setup.model_copy(update={"tick_ns": round(1e9 * tick_s)})
            yield evaluate(HardCase("extreme ticks", f"{name}, {tick}", timed, ticks=ticks))


def saturated_steps() -> Iterator[CaseResult]:
    """Follow a reference that swings faster than the drive can go, then holds.

    An integral that grows in saturation undershoots further than with a fast drive.
    """
    controllers: dict[str, SceneTable] = {
        "position with ki = 500": {**WITH_INTEGRAL, "ki": 500},
        "force with ki = 0.5": {"kp": 0.1, "ki": 0.5},
        "feed-forward": FED,
    }
    drives: dict[str, SceneTable] = {
        "1/16 of 2 mm": STEPPER,
        "1/256 of 1 mm": {**STEPPER, "microsteps": 256, "lead": "1 mm"},
    }

    def swing(tick: int) -> float:
        if not SWING_FROM <= tick < SWING_TO:
            return HELD_N
        turns = SWING_HZ * 1e-3 * (tick - SWING_FROM)
        return HELD_N + 1.0 + 0.9 * math.sin(2 * math.pi * turns)

    for (name, controller), (fine, drive) in product(controllers.items(), drives.items()):
        slow = make_setup(controller, {**drive, "max_speed": f"{SLOW_M_PER_S} m/s"})
        case = HardCase(
            "saturated step rate",
            f"{name}, microsteps {fine}, at most {1e3 * SLOW_M_PER_S:g} mm/s",
            slow,
            reference=swing,
            ticks=SWING_TO + SETTLING,
        )
        result = evaluate(case)
        if result.felt_n is not None:
            free_n, _ = replace(case, setup=make_setup(controller, drive)).run()
            under_n, usual_n = (
                HELD_N - float(felt_n[SWING_TO:].min()) for felt_n in (result.felt_n, free_n)
            )
            microstep_n = HELD_N - settled_range_n(slow, HELD_N)[0]
            if result.verdict is CaseVerdict.STABLE and under_n > usual_n + microstep_n:
                result = result._replace(verdict=CaseVerdict.WRONG, reason="winds up")
        yield result


def force_step() -> Iterator[CaseResult]:
    """Step the reference by 1 N, through Safety as in a display, and without it."""
    pid = make_setup({"kp": 0.1, "ki": 0.5, "kd": 1e-4}, STEPPER)
    setups = {**common_setups(), "PID on force": pid}
    for (name, setup), way in product(setups.items(), ("through", "without")):
        case = HardCase(
            "a step of 1 N",
            f"{name}, {way} Safety",
            setup,
            reference=lambda tick: STEP_TO_N if tick >= STEP_AT else HELD_N,
            with_safety=way == "through",
            target_n=STEP_TO_N,
            ticks=STEP_AT + SETTLING,
        )
        yield evaluate(case)


def chatter_microsteps(setup: DisplayScene, felt_n: Array) -> float:
    """Return the range of the felt force in a run's second half, when a loop has settled."""
    stepper = StepperScene.narrow(setup.actuator, "[display] actuator:")
    felt_n = felt_n[len(felt_n) // 2 :]
    law = stepper.contact(setup.layer.layer())
    travel_m = law.position(float(felt_n.max())) - law.position(float(felt_n.min()))
    return travel_m / stepper.step_m


def direction_chatter() -> Iterator[CaseResult]:
    """Hold a force between two microsteps, without a dead band and with one."""
    rotor: SceneTable = {**STEPPER, "rotor_resonance": "100 Hz"}
    coarse: SceneTable = {"adc_bits": 16, "sensitivity": "44 mV/N"}
    noisy: SceneTable = {"noise": "1 mN"}
    # With the dead band, in microsteps.
    cases: tuple[tuple[str, SceneTable, SceneTable, SceneTable | None, float], ...] = (
        ("kp = 300", ON_POSITION, STEPPER, None, 0.6),
        ("rigid stop, kp = 300", ON_POSITION, RIGID, None, 0.6),
        ("error in force, kp = 0.1", ON_FORCE, STEPPER, None, 0.6),
        ("ki = 1000", WITH_INTEGRAL, STEPPER, None, 0.6),
        ("rotor at 100 Hz, ζ = 0.2", FED, rotor, None, 1.5),
        ("rotor at 100 Hz, film of 40 Hz", FED, rotor, SLOW_FILM, 0.6),
        ("film rounded to 6.9 mN", {**FED, "kp": 390}, STEPPER, coarse, 12.0),
        ("film noise of 1 mN", ON_POSITION, STEPPER, noisy, 12.0),
    )
    for name, controller, actuator, film, dead_band in cases:
        setup = make_setup(controller, actuator, film)
        stepper = StepperScene.narrow(setup.actuator, "[display] actuator:")
        per_step = stepper.step_m
        if setup.controller.error == "force":
            per_step *= stepper.contact(setup.layer.layer()).stiffness(BETWEEN_N)
        yield _at_rest(f"{name}, no dead band", setup)
        changed = setup.controller.model_copy(update={"dead_band": dead_band * per_step})
        run = f"{name}, dead band of {dead_band:g} microsteps"
        yield _at_rest(run, setup.model_copy(update={"controller": changed}))
    for scene in ("radial", "conditioned", "bench", "real_bench"):
        yield _at_rest(f"scenes/{scene}.toml as shipped", scene_setup(scene))


def _at_rest(name: str, setup: DisplayScene) -> CaseResult:
    case = HardCase(
        "direction chatter",
        name,
        setup,
        reference=lambda _: BETWEEN_N,
        target_n=BETWEEN_N,
        tolerance_microsteps=CHATTER_MICROSTEPS,
        ticks=4000,
    )
    result = evaluate(case)
    if result.felt_n is None:
        return result
    microsteps = chatter_microsteps(setup, result.felt_n)
    if result.verdict is not CaseVerdict.STABLE or microsteps <= 1 + 1e-6:
        return result
    if setup.film.noise_n:
        return result._replace(reason="no cycle: it follows the film's noise")
    return result._replace(verdict=CaseVerdict.CYCLES, reason="above one microstep")


def strange_samples() -> Iterator[CaseResult]:
    """Put one sample that is not a usable force into the reference, and into the film's reading."""
    pid = make_setup({"kp": 0.1, "kd": 1e-4}, {"kind": "stepper"})
    setups = {**common_setups(), "PID on force with kd": pid}
    samples_n = {
        "a force spike": (100.0, -100.0, 1e30, -1e30),
        "denormals and NaN": (5e-324, math.nan, math.inf, -math.inf),
    }
    places = ("reference", "reading")
    for (case, strange_n), name, place in product(samples_n.items(), setups, places):
        for value_n in strange_n:
            strange: dict[str, Any] = {place: _strange_at(value_n)}
            run = f"{name}, one {place} of {value_n:g}"
            hard = HardCase(case, run, setups[name], ticks=1000, disturbance_tick=STRANGE_AT)
            yield evaluate(replace(hard, **strange))


def _strange_at(strange_n: float) -> Callable[..., float]:
    return lambda tick, usual_n=HELD_N: strange_n if tick == STRANGE_AT else usual_n


def all_cases() -> Iterator[CaseResult]:
    """Run and judge every case of the loop."""
    yield from stiff_contact()
    yield from nearly_undamped()
    yield from extreme_ticks()
    yield from saturated_steps()
    yield from direction_chatter()
    yield from force_step()
    yield from strange_samples()
