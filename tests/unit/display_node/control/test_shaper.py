"""The input shaper: rest after its steps, and bounds of the rotor's speed behind it."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from display_node.control.shaper import (
    NEVER_RINGS,
    TOLERANCE,
    InputShaper,
    rotor_rings,
    shaper_weights,
    zero_vibration,
)
from display_node.plant.stepper import Rotor

TICK_S = 1e-3
WEIGHTS = shaper_weights(100.0, 0.2, TICK_S)
RESONANCES = st.floats(10, 600)
DAMPINGS = st.floats(0, 0.76)
FURTHER = (1 / (1 + TOLERANCE), 1 - TOLERANCE, 0.9, 1.0, 1.1, 1 + TOLERANCE)


def turned_m(weights: list[float], resonance_hz: float, damping: float) -> NDArray[np.float64]:
    """Return the rotor's positions under shaped steps of 1 m, far beyond the last of them."""
    rotor = Rotor(resonance_hz, damping, TICK_S)
    positions_m, from_m = [], 0.0
    for to_m in [*np.cumsum(weights).tolist(), *[1.0] * 600]:
        positions_m.append(rotor.step(from_m, to_m))
        from_m = to_m
    return np.array(positions_m)


def speed_gain(weights: list[float], resonance_hz: float, damping: float) -> float:
    """Return the rotor's greatest speed, as a factor of the bound of the path's speed.

    The worst of all paths within the bound follows the sign of the response to one step.
    """
    return float(np.abs(np.diff(turned_m(weights, resonance_hz, damping), prepend=0.0)).sum())


@given(RESONANCES, DAMPINGS)
def test_after_the_steps_the_rotor_is_at_rest(resonance_hz: float, damping: float) -> None:
    assume(rotor_rings(resonance_hz, damping, TICK_S))
    weights = zero_vibration(resonance_hz, damping, TICK_S)
    shaped_m = turned_m(weights, resonance_hz, damping)
    assert shaped_m[len(weights) :] == pytest.approx(1, abs=1e-9)
    assert shaped_m.max() < 1 + 1e-9
    # The last step comes half a damped period after the first.
    half_ticks = 1 / (2 * resonance_hz * math.sqrt(1 - damping**2) * TICK_S)
    assert half_ticks <= len(weights) - 1 <= half_ticks + 1


@pytest.mark.parametrize("share", FURTHER)
@pytest.mark.parametrize("damping", [0.16, 0.2, 0.24])
def test_a_rotor_within_20_percent_of_the_model_is_at_most_2_percent_faster(
    share: float, damping: float
) -> None:
    assert speed_gain(WEIGHTS, share * 100.0, damping) < 1.02
    # Neither without a shaper nor with one zero at the resonance.
    assert speed_gain([1.0], share * 100.0, damping) > 2.5
    if abs(share - 1) > 0.15:
        assert speed_gain(zero_vibration(100.0, 0.2, TICK_S), share * 100.0, damping) > 1.3


@given(RESONANCES, st.floats(0.02, 0.76))
def test_the_modelled_rotor_is_no_faster_than_its_path(resonance_hz: float, damping: float) -> None:
    assume(rotor_rings(resonance_hz, damping, TICK_S))
    weights = shaper_weights(resonance_hz, damping, TICK_S)
    assert speed_gain(weights, resonance_hz, damping) == pytest.approx(1, abs=1e-6)


def test_a_damped_rotor_needs_no_shaper() -> None:
    assert not rotor_rings(100.0, NEVER_RINGS, TICK_S)
    assert speed_gain([1.0], 100.0, NEVER_RINGS) < 1.05
    assert rotor_rings(100.0, NEVER_RINGS - 0.01, TICK_S)
    # A tick cannot resolve this swing.
    assert not rotor_rings(600.0, 0.0, TICK_S)


@given(st.lists(st.floats(allow_nan=True), max_size=60), st.integers(1, 40))
def test_no_path_exceeds_the_bound_of_its_speed(positions_m: list[float], ticks: int) -> None:
    shaper = InputShaper(WEIGHTS, TICK_S)
    shaper.start(0.5)
    last_m, most_m = 0.5, 0.01
    for position_m in positions_m:
        shaped_m = shaper.advance(position_m, most_m, ticks)
        assert abs(shaped_m - last_m) <= most_m * ticks + 1e-12
        last_m = shaped_m


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=60))
def test_the_path_stays_between_its_extremes(positions_m: list[float]) -> None:
    shaper = InputShaper(WEIGHTS, TICK_S)
    shaper.start(positions_m[0])
    for position_m in positions_m:
        shaped_m = shaper.advance(position_m, math.inf)
        assert min(positions_m) - 1e-12 <= shaped_m <= max(positions_m) + 1e-12
