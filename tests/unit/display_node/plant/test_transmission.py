import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.signal import lsim

from display_node.plant.stepper import Backlash, Rotor

RESONANCE_HZ = 100.0
W = 2 * math.pi * RESONANCE_HZ


def turned_m(rotor: Rotor, commanded_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """The rotor's position at each instant of a command that runs straight between them."""
    steps = zip(commanded_m[:-1].tolist(), commanded_m[1:].tolist(), strict=True)
    return np.array([0.0] + [rotor.step(from_m, to_m) for from_m, to_m in steps])


@pytest.mark.parametrize("damping", [0.0, 1e-6, 0.2, 1.0, 5.0])
@pytest.mark.parametrize("tick_s", [1e-6, 1e-4, 1e-3, 0.1])
def test_ramps_agree_with_lsim(tick_s: float, damping: float) -> None:
    commanded_m = np.cumsum(np.random.default_rng(2).normal(0, 1e-6, 500))
    commanded_m[0] = 0.0
    system = (W * W, [1.0, 2 * damping * W, W * W])
    _, expected, _ = lsim(system, commanded_m, np.arange(500) * tick_s)
    turned = turned_m(Rotor(RESONANCE_HZ, damping, tick_s), commanded_m)
    assert np.abs(turned - expected).max() < 1e-9 * np.abs(commanded_m).max()


def test_one_ramp_agrees_with_its_differential_equation() -> None:
    damping, speed = 0.2, 0.01
    solved = solve_ivp(
        lambda t, x: [x[1], W * W * (speed * t - x[0]) - 2 * damping * W * x[1]],
        (0, 0.05),
        [0, 0],
        t_eval=np.arange(51) * 1e-3,
        rtol=1e-10,
        atol=1e-15,
    )
    turned = turned_m(Rotor(RESONANCE_HZ, damping, 1e-3), np.linspace(0, 0.05 * speed, 51))
    assert np.abs(turned - solved.y[0]).max() < 1e-9 * speed


@pytest.mark.parametrize("tick_s", [1e-6, 1e-3, 0.1003])
def test_without_damping_it_rings_for_ever_and_no_higher(tick_s: float) -> None:
    turned = turned_m(Rotor(RESONANCE_HZ, 0.0, tick_s), np.array([0.0] + [1e-6] * 200_000))
    last = turned[-100_000:]
    assert 1e-6 < turned.max() <= 2e-6 * (1 + 1e-6)
    assert turned.min() >= -1e-6 * 1e-6
    assert np.ptp(last) == pytest.approx(np.ptp(turned[1:100_000]), rel=1e-3)


@pytest.mark.parametrize("tick_s", [1e-6, 1e-3, 0.1])
@pytest.mark.parametrize("damping", [0.2, 2.0])
def test_at_rest_it_is_where_the_microstep_says(tick_s: float, damping: float) -> None:
    rotor = Rotor(RESONANCE_HZ, damping, tick_s)
    ticks = 2 + round(0.3 / tick_s)
    turned = turned_m(rotor, np.array([0.0] + [3e-6] * ticks))
    assert turned[-1] == pytest.approx(3e-6, rel=1e-6)


def test_a_jump_rings_at_the_resonance_and_fades_by_the_damping() -> None:
    damping, tick_s = 0.05, 1e-5
    turned = turned_m(Rotor(RESONANCE_HZ, damping, tick_s), np.array([0.0] + [1.0] * 3000))
    peaks = np.flatnonzero((turned[1:-1] > turned[:-2]) & (turned[1:-1] >= turned[2:])) + 1
    damped = math.sqrt(1 - damping**2)
    assert np.diff(peaks)[:2] * tick_s == pytest.approx(1 / (RESONANCE_HZ * damped), rel=2e-3)
    fading = (turned[peaks[1]] - 1) / (turned[peaks[0]] - 1)
    assert fading == pytest.approx(math.exp(-2 * math.pi * damping / damped), rel=1e-3)


def test_a_rotor_at_rest_stays_at_rest() -> None:
    assert turned_m(Rotor(RESONANCE_HZ, 0.0, 1e-3), np.zeros(50)).tolist() == [0.0] * 50


ways = st.lists(st.floats(-10, 10), min_size=1, max_size=50)


@settings(deadline=None)
@given(ways, st.floats(0.01, 5))
def test_play_stays_within_its_gap_and_moves_no_more_than_it_must(
    way: list[float], width: float
) -> None:
    play, before = Backlash(width), 0.0
    for driving in way:
        driven = play.step(driving)
        assert abs(driven - driving) <= width / 2 * (1 + 1e-9) + 1e-12
        # The nearest place to the last one that the gap allows: the play operator.
        assert driven == min(max(before, driving - width / 2), driving + width / 2)
        before = driven


def test_play_is_crossed_by_its_whole_width_after_a_reversal() -> None:
    play = Backlash(2.0)
    assert [play.step(x) for x in (0.5, 1.0, 4.0)] == [0.0, 0.0, 3.0]
    assert [play.step(x) for x in (3.0, 2.0, 1.5)] == [3.0, 3.0, 2.5]
    assert [play.step(x) for x in (2.5, 3.5, 3.6)] == [2.5, 2.5, pytest.approx(2.6)]


@settings(deadline=None)
@given(ways)
def test_the_same_place_again_moves_nothing(way: list[float]) -> None:
    play = Backlash(1.0)
    for driving in way:
        assert play.step(driving) == play.step(driving)


@settings(deadline=None)
@given(ways)
def test_a_detour_within_the_gap_leaves_no_trace(way: list[float]) -> None:
    straight, detour = Backlash(1.0), Backlash(1.0)
    for driving in way:
        driven = straight.step(driving)
        assert detour.step(driving) == driven
        for share in (0.49, -0.49):
            assert detour.step(driven + share) == driven
