import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.control.linear_loop import LinearLoop
from display_node.control.observer import DESIGN_FORCE_N
from tests.support.force_loops import FINE, LAYER, TICK_S, Case, Shipped, Table

POSITION: Table = {"error": "position", "kp": 100}
OBSERVED = POSITION | {"feed_forward": True, "observer": {"wander": "0.1 mm", "softening": 0}}
PAPERS: Table = {"kp": 15, "ki": 0.15, "kd": 0.03, "derivative_filter": "200 Hz"}
ROTOR = FINE | {"rotor_resonance": "100 Hz"}
SECOND_ORDER: Table = {"kind": "second_order"}
SLOW: Table = {"filter": "40 Hz", "noise": "2 mN"}
LATE: Table = {"latency": "1.3 ms"}

UNFILTERED = {
    "position": Case(POSITION),
    "position, all gains": Case(POSITION | {"ki": 200, "kd": 0.05}),
    "force": Case({"kp": 0.1, "ki": 0.5, "kd": 1e-4}),
    "millivolts": Case({"kp": 2e-5, "error": "millivolts"}),
    "rotor": Case(POSITION | {"kp": 50}, ROTOR),
}
CASES = UNFILTERED | {
    "feed-forward": Case(POSITION | {"feed_forward": True}),
    "film": Case(POSITION | {"kp": 50}, FINE, SLOW | {"filter_order": 2}),
    "rotor and film": Case(POSITION | {"kp": 30}, ROTOR, SLOW),
    "observer": Case(OBSERVED, FINE, {"noise": "2 mN"}),
    "observer, rotor and film": Case(OBSERVED, ROTOR, SLOW),
    "observer, all": Case(OBSERVED | {"ki": 100, "kd": 0.02}, ROTOR, SLOW | {"filter_order": 3}),
    "late drive": Case(POSITION, FINE | {"latency": "2 ms"}),
    "late film": Case(POSITION, FINE, SLOW | LATE),
    "late rotor and film": Case(POSITION | {"kp": 30}, ROTOR | LATE, SLOW | {"latency": "3 ms"}),
    "observer, late drive": Case(OBSERVED, FINE | LATE, {"noise": "2 mN"}),
    "observer, all of it late": Case(OBSERVED, ROTOR | LATE, SLOW | {"latency": "4.5 ms"}),
    "second order": Case(PAPERS | {"error": "millivolts"}, SECOND_ORDER),
    "second order, newtons": Case(PAPERS, SECOND_ORDER),
    "second order and film": Case(
        PAPERS | {"error": "millivolts"}, SECOND_ORDER, {"filter": "300 Hz"}
    ),
    "second order and late film": Case(PAPERS, SECOND_ORDER, LATE),
}
every_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())


def tips(loop: LinearLoop, noise: NDArray[np.float64]) -> NDArray[np.float64]:
    state, moved = np.zeros(len(loop.a)), []
    for value in noise.tolist():
        state = loop.closed @ state + loop.closed_noise * value
        moved.append(loop.tip @ state)
    return np.array(moved)


@every_case
def test_it_moves_as_the_shipped_loop_does(case: Case) -> None:
    # An impulse, a step and noise; in the loop's unit, and so little that the contact law is
    # straight.
    noise = np.zeros(400)
    noise[0], noise[100:200] = 1.0, 1.0
    noise[200:300] = np.random.default_rng(1).normal(0, 1, 100)
    noise *= 1e-6 if case.actuator is SECOND_ORDER else 1e-9
    disturbed, left_alone = Shipped(case).settled(), Shipped(case).settled()
    scale_n = case.newtons_per_unit
    off_n = [disturbed.tick(noise_n=scale_n * each) - left_alone.tick() for each in noise.tolist()]
    expected = tips(case.linear(), noise)
    for part in (slice(0, 100), slice(100, 200), slice(200, 400)):
        largest = np.abs(expected[part]).max()
        assert largest > 1e-11
        assert np.abs(np.array(off_n)[part] / scale_n - expected[part]).max() < 1e-3 * largest


@pytest.mark.parametrize("case", UNFILTERED.values(), ids=UNFILTERED.keys())
def test_a_displaced_finger_is_a_jump_of_the_reference(case: Case) -> None:
    loop = case.linear()
    state, moved = loop.displaced, []
    jumped, left_alone = Shipped(case).settled(), Shipped(case).settled()
    jump_n = 1e-9 * case.newtons_per_unit
    off = []
    for _ in range(300):
        state = loop.closed @ state
        moved.append(loop.tip @ state)
        off.append((jumped.tick(DESIGN_FORCE_N + jump_n) - left_alone.tick()) / jump_n)
    assert np.abs(1 - np.array(off) - np.array(moved)).max() < 1e-3


@every_case
def test_left_alone_it_comes_to_rest_after_a_displacement(case: Case) -> None:
    loop = case.linear()
    assert np.abs(loop.poles()).max() < 1 - 1e-6
    assert loop.tip @ loop.displaced == 1.0
    state = np.linalg.matrix_power(loop.closed, 6000) @ loop.displaced
    # The paper's gains read as newtons let the actuator swing on for seconds.
    assert abs(loop.tip @ state) < 0.05


@pytest.mark.parametrize("kp", [30.0, 100.0, 300.0])
def test_a_plain_position_loop_has_the_pole_of_backward_euler(kp: float) -> None:
    poles = Case(POSITION | {"kp": kp}).linear().poles()
    assert np.abs(poles - 1 / (1 + kp * TICK_S)).min() < 1e-9


@every_case
def test_poles_are_what_a_response_is_made_of(case: Case) -> None:
    loop = case.linear()
    response = tips(loop, np.array([1.0] + [0.0] * 400))
    # A sequence made of these poles alone is annihilated by their polynomial.
    polynomial = np.real(np.poly(loop.poles()))
    left = np.convolve(response, polynomial)[len(polynomial) : len(response)]
    assert np.abs(left).max() < 1e-9 * np.abs(response).max()


def test_the_loop_gain_of_a_force_error_grows_with_the_force() -> None:
    case = UNFILTERED["force"]
    _, actuator, _ = case.scenes
    assert actuator.kind == "stepper"
    law = actuator.contact(LAYER)
    gentle, firm = (case.linear(force_n) for force_n in (0.01, 1.0))
    # The output for a displacement of 1, before the implicit law takes its share.
    ratio = (firm.c @ firm.displaced) / (gentle.c @ gentle.displaced)
    assert 1 < ratio < law.stiffness(1.0) / law.stiffness(0.01)
    same = [CASES["position"].linear(force_n).c for force_n in (0.01, 1.0)]
    assert (same[0] == same[1]).all()
