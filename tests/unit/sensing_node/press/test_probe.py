"""The probe's force loop on the synthetic wrist, and its bounds for any input."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from protocol.tissue import StiffeningLaw
from sensing_node.press.probe import CLEARANCE_M, Probe, ProbeLimits
from sensing_node.sources.wrist import Wrist, WristScene

LIMITS = ProbeLimits()
STEP_S = 5e-3
TISSUES = pytest.mark.parametrize("stiffness", [0.3, 1.0, 3.0])


def wrist(stiffness: float = 1.0) -> Wrist:
    length_m = StiffeningLaw(length_m=1.2e-3 / stiffness).length_m
    return Wrist(WristScene.model_validate({"kind": "wrist", "length": f"{length_m} m"}))


def held(
    source: Wrist, seconds: float, force_n: Callable[[float], float | None]
) -> NDArray[np.float64]:
    """Press with forces at times, None for no set-point; return the true force every 5 ms."""
    forces = []
    for number in range(round(seconds / STEP_S)):
        wanted_n = force_n(number * STEP_S)
        if wanted_n is not None and number % 4 == 0:
            source.press(wanted_n)
        source.take(5)
        forces.append(source.force_n)
    return np.array(forces)


def at(seconds: float) -> int:
    return round(seconds / STEP_S)


@TISSUES
def test_a_set_point_is_reached_within_a_fifth_of_a_second(stiffness: float) -> None:
    forces = held(wrist(stiffness), 5.0, lambda t_s: 0.6 if t_s < 2 else 1.5 if t_s < 3.5 else 0.4)
    for step_s, wanted_n in ((2.0, 1.5), (3.5, 0.4)):
        later = forces[at(step_s + 0.2) : at(step_s + 1.4)]
        assert np.abs(later / wanted_n - 1).max() < 0.05


@TISSUES
def test_neither_force_nor_slew_limit_is_passed_by_any_set_points(stiffness: float) -> None:
    random = np.random.default_rng(3)
    hostile = [0.0, 1e6, 3.0, 1e-300, 0.2, 1e6, 2.9]
    for choose in (
        lambda t_s: 1e6 if int(t_s / 0.7) % 2 else 0.0,
        lambda t_s: hostile[int(random.integers(len(hostile)))],
    ):
        forces = held(wrist(stiffness), 8.0, choose)
        assert forces.max() > 0.5
        assert forces.max() <= LIMITS.force_limit_n
        assert np.abs(np.diff(forces)).max() / STEP_S <= LIMITS.slew_limit_n_per_s


@TISSUES
def test_after_a_cut_the_probe_eases_off_within_half_a_second_then_leaves(stiffness: float) -> None:
    source = wrist(stiffness)
    forces = held(source, 5.0, lambda t_s: 2.8 if t_s < 2 else None)
    assert forces[at(2.0) - 1] > 2.7
    assert forces[at(2.5) :].max() <= LIMITS.resting_n + 0.05
    assert forces[at(3.0) : at(3.9)].min() > LIMITS.resting_n - 0.05
    assert forces[at(4.2) :].max() == 0.0
    assert source.state == "off"
    assert source.depth_m < -0.5 * CLEARANCE_M


def test_a_force_that_returns_rises_slowly() -> None:
    source = wrist()
    held(source, 2.0, lambda t_s: 1.5 if t_s < 1 else None)
    assert source.state == "easing"
    forces = held(source, 1.0, lambda t_s: 1.5)
    assert np.diff(forces).max() / STEP_S < 0.3 * LIMITS.slew_limit_n_per_s
    assert forces[-1] == pytest.approx(1.5, rel=0.05)


@pytest.mark.parametrize("force_n", [math.nan, -1.0, -math.inf])
def test_a_set_point_that_is_no_force_releases_the_wrist(force_n: float) -> None:
    source = wrist()
    held(source, 1.0, lambda t_s: 1.0)
    assert held(source, 1.0, lambda t_s: force_n)[-1] < 0.05


@pytest.mark.parametrize(
    ("cell_n", "position_m", "fault"),
    [
        (math.nan, 0.0, "no number"),
        (math.inf, 0.0, "no number"),
        (1.01 * LIMITS.force_limit_n * LIMITS.overforce, 0.0, "more than"),
        (0.0, LIMITS.travel_m + 1e-6, "travel"),
        (0.0, math.nan, "travel"),
    ],
)
def test_an_impossible_value_is_a_fault_and_the_probe_leaves_for_good(
    cell_n: float, position_m: float, fault: str
) -> None:
    probe = Probe(LIMITS)
    probe.press(1.0, 0)
    probe.step(0.5, 0.0, 3e-3, 0)
    assert probe.step(cell_n, 0.0, position_m, 1_000_000) <= 0.0
    assert fault in str(probe.faults[0])
    for number in range(2, 100):
        probe.press(1.0, number * 1_000_000)
        assert probe.step(0.5, 0.0, 3e-3, number * 1_000_000) < 0.0
    assert probe.state == "fault"


def test_a_silent_load_cell_is_a_fault() -> None:
    probe = Probe(LIMITS)
    probe.step(0.1, 0.0, 0.0, 0)
    probe.step(None, 0.0, 0.0, LIMITS.cell_within_ns)
    assert not probe.faults
    probe.step(None, 0.0, 0.0, LIMITS.cell_within_ns + 1)
    assert list(map(str, probe.faults)) == ["load cell: silent"]


ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True)


@settings(max_examples=50)
@given(st.lists(st.tuples(ANY_FLOAT, ANY_FLOAT, ANY_FLOAT, ANY_FLOAT), max_size=30))
def test_no_input_passes_the_speed_limit_or_raises(
    steps: list[tuple[float, float, float, float]],
) -> None:
    probe = Probe(LIMITS)
    for number, (force_n, cell_n, pulse_n, position_m) in enumerate(steps):
        probe.press(force_n, number * 1_000_000)
        speed = probe.step(cell_n, pulse_n, position_m, number * 1_000_000)
        assert abs(speed) <= LIMITS.max_speed_m_per_s
        assert 0.0 <= probe.reference_n <= LIMITS.force_limit_n
