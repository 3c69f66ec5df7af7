"""Hard cases for the force loop as it is shipped: it settles, or is refused with a reason."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from display_node.plant.scene import SecondOrderScene, StepperScene
from display_node.scene import DisplayScene
from protocol.config.scene import validate
from protocol.errors import SceneError
from protocol.faults import FaultKind
from telepulse.paper import published
from telepulse.paper.stability import BOUND_N, HELD_N, Array
from tests.system.stability.hard_case import (
    COMMON,
    SceneTable,
    assert_comes_to_rest,
    assert_settled,
    make_setup,
    run,
    scene_setup,
    settled_range_n,
)

STEPPER: SceneTable = {"kind": "stepper"}
RIGID: SceneTable = {"kind": "stepper", "fingertip": "1e9 N/m"}
RINGING: SceneTable = {"kind": "stepper", "rotor_resonance": "100 Hz"}
SLOW_FILM: SceneTable = {"filter": "40 Hz"}
STIFF: SceneTable = {"young_modulus": "5e9 Pa"}
ON_FORCE: SceneTable = {"kp": 0.1}
ON_POSITION: SceneTable = {"kp": 300, "error": "position"}
WITH_INTEGRAL: SceneTable = {"kp": 100, "ki": 1000, "error": "position"}
FED: SceneTable = {"kp": 100, "error": "position", "feed_forward": True}
SLOWLY_FED: SceneTable = {**FED, "kp": 10}
OBSERVED: SceneTable = {**FED, "kp": 130, "observer": {"wander": "0.1 mm"}}
# An integral settles with ki / kp = 5 /s: 2 s leave e^−10.
SETTLING = 4000


@pytest.mark.parametrize("controller", [ON_FORCE, ON_POSITION], ids=["force", "position"])
@pytest.mark.parametrize("film", [None, SLOW_FILM], ids=["ideal film", "slow film"])
@pytest.mark.parametrize(
    ("actuator", "layer"),
    [(RIGID, None), (STEPPER, STIFF), (RIGID, STIFF)],
    ids=["rigid stop", "5 GPa", "rigid stop, 5 GPa"],
)
def test_stiff_contacts_are_pressed_without_swinging(
    actuator: SceneTable, layer: SceneTable | None, film: SceneTable | None, controller: SceneTable
) -> None:
    setup = make_setup(controller, actuator, film, layer)
    felt_n, faults = run(setup)
    assert faults == []
    assert_settled(setup, felt_n)


def undamped(c: float, setup: DisplayScene) -> DisplayScene:
    """Return a setup with the paper's actuator, damped by c."""
    damped = published.ACTUATOR.model_copy(update={"c": c})
    return setup.model_copy(update={"actuator": damped})


PROPORTIONAL = make_setup({"kp": 15, "error": "force"}, {"kind": "second_order"})
FINE: SceneTable = {**RIGID, "lead": "0.1 mm"}
FOUR_POLES: SceneTable = {**SLOW_FILM, "filter_order": 4}


@pytest.mark.parametrize(
    "setup",
    [
        # Eq 22 without damping needs a derivative.
        undamped(0.0, COMMON["eq 22"]),
        undamped(1e-9, COMMON["eq 22"]),
        make_setup(SLOWLY_FED, RINGING),
        make_setup(OBSERVED, RINGING),
    ],
    ids=["eq 22, c = 0", "eq 22, c = 1e-9", "rotor", "rotor with observer"],
)
def test_nearly_undamped_loops_settle(setup: DisplayScene) -> None:
    felt_n, faults = run(setup)
    assert faults == []
    assert_settled(setup, felt_n)


@pytest.mark.parametrize(
    ("setup", "reason"),
    [
        (make_setup({"kp": 10}, FINE, FOUR_POLES, STIFF), r"not stable \(largest pole 1\.\d+, "),
        (undamped(0.0, PROPORTIONAL), "hardly stable"),
        (undamped(1e-9, PROPORTIONAL), "hardly stable"),
        # A rotor that rings for ever.
        (make_setup(SLOWLY_FED, {**RINGING, "rotor_damping": 1e-6}), "not stable"),
        (make_setup(SLOWLY_FED, {**RINGING, "rotor_damping": 0.0}), "not stable"),
        (make_setup(OBSERVED, {**RINGING, "rotor_damping": 1e-6}), "hardly stable"),
        (make_setup(OBSERVED, {**RINGING, "rotor_damping": 0.0}), "not stable"),
        (make_setup({"kp": 390, "error": "position"}, RINGING), "not stable"),
    ],
)
def test_a_loop_that_would_swing_is_refused_in_one_line(setup: DisplayScene, reason: str) -> None:
    with pytest.raises(SceneError, match=reason) as refused:
        setup.force_loop()
    assert "\n" not in str(refused.value)


def test_a_vanishing_mass_is_refused() -> None:
    with pytest.raises(SceneError, match="m: must be greater"):
        validate({"kind": "second_order", "m": 1e-300}, SecondOrderScene, "actuator:")


def test_without_the_refusal_an_undamped_loop_would_leave_the_bounds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("display_node.control.force_loop.refuse_unstable", lambda *_: None)
    setup = make_setup({"kp": 100, "error": "position"}, {**RINGING, "rotor_damping": 0.0})
    felt_n, _ = run(setup, with_safety=False)
    assert np.abs(felt_n).max() > BOUND_N


@pytest.mark.parametrize("name", COMMON)
@pytest.mark.parametrize(("tick_s", "ticks"), [(1e-6, 120_000), (0.1, 400)], ids=["1 µs", "100 ms"])
def test_extreme_ticks_settle(name: str, tick_s: float, ticks: int) -> None:
    setup = COMMON[name].model_copy(update={"tick_ns": round(1e9 * tick_s)})
    felt_n, faults = run(setup, ticks=ticks)
    assert faults == []
    assert_settled(setup, felt_n)


SWING_FROM, SWING_TO = 500, 1500


def swing_n(tick: int) -> float:
    """Return a force that swings faster than a slow drive can go, then holds."""
    if not SWING_FROM <= tick < SWING_TO:
        return HELD_N
    return HELD_N + 1.0 + 0.9 * math.sin(2 * math.pi * 5.0 * 1e-3 * (tick - SWING_FROM))


@pytest.mark.parametrize(
    "controller",
    [{**WITH_INTEGRAL, "ki": 500}, {"kp": 0.1, "ki": 0.5}, FED],
    ids=["position", "force", "feed-forward"],
)
@pytest.mark.parametrize(
    "drive", [STEPPER, {**STEPPER, "microsteps": 256, "lead": "1 mm"}], ids=["coarse", "fine"]
)
def test_a_saturated_step_rate_winds_nothing_up(controller: SceneTable, drive: SceneTable) -> None:
    """An integral that grows in saturation undershoots further than with a fast drive."""
    slow, free = (
        make_setup(controller, {**drive, "max_speed": "2 mm/s"}),
        make_setup(controller, drive),
    )
    ticks = SWING_TO + SETTLING
    (felt_n, faults), (free_n, _) = (run(each, swing_n, ticks=ticks) for each in (slow, free))
    assert faults == []
    assert_settled(slow, felt_n)
    under_n, usual_n = (HELD_N - float(each[SWING_TO:].min()) for each in (felt_n, free_n))
    assert under_n <= usual_n + HELD_N - settled_range_n(slow, HELD_N)[0]


STEP_AT, STEP_TO_N = 500, HELD_N + 1.0
PID_ON_FORCE = make_setup({"kp": 0.1, "ki": 0.5, "kd": 1e-4}, STEPPER)


@pytest.mark.parametrize("with_safety", [True, False], ids=["through Safety", "without Safety"])
@pytest.mark.parametrize("name", [*COMMON, "PID"])
def test_a_step_settles_and_keeps_the_slew_limit(name: str, with_safety: bool) -> None:
    setup = COMMON.get(name, PID_ON_FORCE)
    ticks = STEP_AT + SETTLING
    felt_n, faults = run(
        setup,
        lambda tick: STEP_TO_N if tick >= STEP_AT else HELD_N,
        with_safety=with_safety,
        ticks=ticks,
    )
    assert faults == []
    assert_settled(setup, felt_n, STEP_TO_N)
    if name == "bench" and with_safety:
        assert felt_n.max() == pytest.approx(STEP_TO_N, abs=1e-3)
        # The slew limit is 50 N/s, and a microstep more.
        assert np.diff(felt_n[STEP_AT - 1 :]).max() <= 51e-3


# About halfway between two microsteps of the scenes' steppers.
BETWEEN_N = 0.3003
# A cycle up to this size is a cycle; with a larger one the loop does not settle.
CHATTER_MICROSTEPS = 20.0


def chatter_microsteps(setup: DisplayScene) -> float:
    """Return by how many microsteps a settled loop moves while it holds a force between two."""
    felt_n, faults = run(setup, lambda _: BETWEEN_N, ticks=4000)
    assert faults == []
    assert_settled(setup, felt_n, BETWEEN_N, CHATTER_MICROSTEPS)
    stepper = StepperScene.narrow(setup.actuator, "[display] actuator:")
    law = stepper.contact(setup.layer.layer())
    settled_n: Array = felt_n[len(felt_n) // 2 :]
    travel_m = law.position(float(settled_n.max())) - law.position(float(settled_n.min()))
    return travel_m / stepper.step_m


@pytest.mark.parametrize(
    ("controller", "actuator", "film", "dead_band", "cycles"),
    [
        (ON_POSITION, STEPPER, None, 0.6, False),
        (ON_POSITION, RIGID, None, 0.6, False),
        (ON_FORCE, STEPPER, None, 0.6, False),
        (WITH_INTEGRAL, STEPPER, None, 0.6, False),
        (FED, RINGING, None, 1.5, True),
        (FED, RINGING, SLOW_FILM, 0.6, True),
        # Rounded to 6.9 mN.
        ({**FED, "kp": 390}, STEPPER, {"adc_bits": 16, "sensitivity": "44 mV/N"}, 12.0, True),
    ],
)
def test_a_dead_band_ends_every_cycle_between_two_microsteps(
    controller: SceneTable,
    actuator: SceneTable,
    film: SceneTable | None,
    dead_band: float,
    cycles: bool,
) -> None:
    setup = make_setup(controller, actuator, film)
    stepper = StepperScene.narrow(setup.actuator, "[display] actuator:")
    assert (chatter_microsteps(setup) > 1 + 1e-6) == cycles
    band = dead_band * stepper.step_m
    if setup.controller.error == "force":
        band *= stepper.contact(setup.layer.layer()).stiffness(BETWEEN_N)
    banded = setup.controller.model_copy(update={"dead_band": band})
    assert chatter_microsteps(setup.model_copy(update={"controller": banded})) <= 1 + 1e-6


@pytest.mark.parametrize("name", ["radial", "conditioned", "bench"])
def test_no_shipped_scene_without_noise_cycles(name: str) -> None:
    assert chatter_microsteps(scene_setup(name)) <= 1 + 1e-6


STRANGE_AT = 500
STRANGE_N = (100.0, -100.0, 1e30, -1e30, 5e-324, math.nan, math.inf, -math.inf)
PID_WITH_KD = make_setup({"kp": 0.1, "kd": 1e-4}, STEPPER)


def strange(value_n: float) -> Callable[..., float]:
    """Return a reference, or a reading, that is a value at one tick."""
    return lambda tick, usual_n=HELD_N: value_n if tick == STRANGE_AT else usual_n


@pytest.mark.parametrize("name", [*COMMON, "PID"])
@pytest.mark.parametrize("value_n", STRANGE_N)
def test_one_strange_reference_or_reading_is_bridged_or_ends_at_rest(
    name: str, value_n: float
) -> None:
    setup = COMMON.get(name, PID_WITH_KD)
    felt_n, faults = run(setup, strange(value_n), ticks=1000)
    assert faults == []
    assert_settled(setup, felt_n)
    felt_n, faults = run(setup, reading=strange(value_n), ticks=1000)
    if value_n == 5e-324:
        assert faults == []
        assert_settled(setup, felt_n)
        return
    finite = math.isfinite(value_n)
    (fault,) = faults
    assert fault.kind is (FaultKind.OVERFORCE if finite else FaultKind.NOT_A_NUMBER)
    assert_comes_to_rest(setup, felt_n, STRANGE_AT)
