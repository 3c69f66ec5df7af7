"""The stepper: its step rate, rotor, backlash and contact."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.signal import lsim

from display_node.plant.scene import StepperScene
from display_node.plant.stepper import Backlash, Rotor, Stepper
from protocol.tactile import ElasticLayer

RESONANCE_HZ = 100.0
W = 2 * math.pi * RESONANCE_HZ


def turned_m(rotor: Rotor, commanded_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotor's positions under a command that is linear between ticks."""
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


@settings(deadline=None)
@given(st.lists(st.floats(-10, 10), min_size=1, max_size=50), st.floats(0.01, 5))
def test_backlash_is_the_play_operator(path: list[float], width: float) -> None:
    backlash, before = Backlash(width), 0.0
    for driving in path:
        driven = backlash.step(driving)
        # The nearest position to the last one within the gap.
        assert driven == min(max(before, driving - width / 2), driving + width / 2)
        before = driven


TICK_S = 1e-3
LIMIT_N = 2.5
FORWARD, BACK, HALT = math.inf, -math.inf, 0.0


def scene(**table: object) -> StepperScene:
    return StepperScene.model_validate({"kind": "stepper"} | table)


def stepper(limit_n: float = LIMIT_N, tick_s: float = TICK_S, **table: object) -> Stepper:
    """Return a stepper that takes step rates in Hz in place of speeds."""
    description = scene(**table)
    law = description.contact(ElasticLayer())
    return Stepper(description, law, limit_n, tick_s, steps_per_m=1.0)


def positions_m(under_test: Stepper, command: float, ticks: int) -> list[float]:
    positions = []
    for _ in range(ticks):
        under_test.step(command)
        positions.append(under_test.tip_m)
    return positions


def test_the_defaults_are_those_of_the_paper() -> None:
    default = scene()
    assert math.degrees(default.step_angle_rad) == pytest.approx(1.8)
    assert (default.stroke_m, default.max_speed_m_per_s, default.thrust_n) == (0.1, 0.4, 100.0)
    assert scene(lead="2 mm").step_m == pytest.approx(2e-3 / 3200)
    assert scene(lead="6 mm", microsteps=1).step_m == pytest.approx(6e-3 / 200)
    assert scene(lead="2 mm").steps_per_m == pytest.approx(3200 / 2e-3)


commands = st.tuples(
    st.floats(-1e7, 1e7) | st.sampled_from([-math.inf, 0.0, math.inf]), st.integers(1, 40)
)


@pytest.mark.parametrize("limit_n", [0.3, 2.5, 200.0])
@pytest.mark.parametrize("fingertip", ["1 N/mm", "1000 N/mm"])
@settings(deadline=None)
@given(sequence=st.lists(commands, max_size=12))
def test_no_command_presses_harder_than_the_limit_or_leaves_the_stroke(
    limit_n: float, fingertip: str, sequence: list[tuple[float, int]]
) -> None:
    under_test = stepper(limit_n, fingertip=fingertip, stroke="20 mm")
    step_m, last_m = scene().step_m, 0.0
    law = scene(fingertip=fingertip).contact(ElasticLayer())
    for command, ticks in sequence:
        for _ in range(ticks):
            force_n, position_m = under_test.step(command), under_test.tip_m
            assert 0 <= force_n <= min(limit_n, 100.0) * (1 + 1e-12)
            assert 0 <= position_m <= 20e-3
            assert abs(position_m - last_m) < 0.4 * TICK_S + 1.001 * step_m
            assert position_m / step_m == pytest.approx(round(position_m / step_m), abs=1e-6)
            assert force_n == law.force(position_m) == under_test.force_n
            last_m = position_m


@pytest.mark.parametrize(
    ("limit_n", "table", "end_n"),
    [(2.5, {}, 2.5), (0.5, {}, 0.5), (100.0, {"thrust": "5 N", "max_speed": "0.1 m/s"}, 5.0)],
)
def test_the_tip_stops_within_a_microstep_of_the_limit_and_comes_back(
    limit_n: float, table: dict[str, object], end_n: float
) -> None:
    under_test = stepper(limit_n, **table)
    assert (under_test.force_n, under_test.tip_m, under_test.step(HALT)) == (0.0, 0.0, 0.0)
    positions_m(under_test, FORWARD, 2000)
    microstep_n = 1e3 * scene().step_m
    assert end_n - 1.01 * microstep_n < under_test.force_n <= end_n
    stopped_m = under_test.tip_m
    assert positions_m(under_test, FORWARD, 10) == [stopped_m] * 10
    # The tip retracts at once, and rests at zero.
    assert positions_m(under_test, BACK, 3)[-1] < stopped_m
    assert (positions_m(under_test, BACK, 500)[-1], under_test.force_n) == (0.0, 0.0)


def test_travel_is_rate_times_time_also_below_one_step_a_tick() -> None:
    under_test = stepper(limit_n=100.0)
    start_m = positions_m(under_test, 1000.0, 10)[-1]
    end_m = positions_m(under_test, 1000.0, 2000)[-1]
    assert end_m - start_m == pytest.approx(2000 * scene().step_m, rel=1e-9)
    positions = positions_m(stepper(), 50.0, 1000)
    assert positions[-1] == pytest.approx(50 * scene().step_m)
    assert len(set(positions)) == 51


@pytest.mark.parametrize(("steps_per_m", "travel_m"), [(None, 1e-3), (160_000.0, 0.5e-3)])
def test_the_step_rate_is_the_speed_times_the_factor_of_the_vco(
    steps_per_m: float | None, travel_m: float
) -> None:
    named = scene(lead="10 mm")
    assert named.steps_per_m == pytest.approx(320_000)
    law = named.contact(ElasticLayer())
    under_test = Stepper(named, law, 100.0, TICK_S, steps_per_m=steps_per_m)
    assert positions_m(under_test, 0.5e-3, 2000)[-1] == pytest.approx(travel_m, abs=named.step_m)


@pytest.mark.parametrize("tick_s", [1e-4, 1e-3, 5e-3])
def test_acceleration_and_speed_are_limited(tick_s: float) -> None:
    under_test = stepper(limit_n=100.0, tick_s=tick_s)
    start_ticks = round(0.02 / tick_s)
    starting = positions_m(under_test, FORWARD, start_ticks)
    for tick, position_m in enumerate(starting, start=1):
        expected_m = 20.0 * tick_s**2 * tick * (tick + 1) / 2
        assert position_m == pytest.approx(expected_m, abs=0.51 * scene().step_m)
    end_m = positions_m(under_test, FORWARD, round(0.1 / tick_s))[-1]
    assert end_m - starting[-1] == pytest.approx(0.4 * 0.1, rel=1e-3)


def test_a_reversal_brakes_as_long_as_a_halt() -> None:
    turning, halting = stepper(limit_n=100.0), stepper(limit_n=100.0)
    for under_test in (turning, halting):
        positions_m(under_test, FORWARD, 30)
    turned_m, halted_m = positions_m(turning, BACK, 60), positions_m(halting, HALT, 60)
    # From 0.4 m/s at 20 m/s².
    assert turned_m.index(max(turned_m)) in (18, 19, 20)
    assert turned_m[-1] < turned_m[19]
    assert halted_m[25:] == [halted_m[-1]] * 35
    assert halted_m[-1] > halted_m[0]


@pytest.mark.parametrize("table", [{}, {"rotor_resonance": "100 Hz"}, {"backlash": "20 µm"}])
def test_the_tip_moves_as_rotor_and_backlash_do(table: dict[str, object]) -> None:
    under_test, named = stepper(**table), scene(**table)
    rotor = None
    if named.rotor_resonance_hz is not None:
        rotor = Rotor(named.rotor_resonance_hz, named.rotor_damping, TICK_S)
    backlash = Backlash(named.backlash_m)
    law = named.contact(ElasticLayer())
    before_m = 0.0
    for tick in range(600):
        # An oscillation of 5 Hz, well within the limits of speed and acceleration.
        force_n = under_test.step(20_000 * math.sin(2 * math.pi * 5 * tick * TICK_S))
        at_m = round(under_test.screw_m / named.step_m) * named.step_m
        driving_m = at_m if rotor is None else rotor.step(before_m, at_m)
        before_m = at_m
        assert under_test.tip_m == pytest.approx(backlash.step(driving_m), abs=1e-15)
        assert force_n == law.force(under_test.tip_m)


@pytest.mark.parametrize("limit_n", [0.3, 2.5])
@pytest.mark.parametrize("backlash", ["3 µm", "20 µm", "1 mm"])
def test_with_backlash_exactly_the_whole_range_is_reached(backlash: str, limit_n: float) -> None:
    under_test = stepper(limit_n, backlash=backlash)
    microstep_n = 1e3 * scene().step_m
    for _ in range(2):
        positions_m(under_test, FORWARD, 1000)
        assert limit_n - 1.01 * microstep_n < under_test.force_n <= limit_n * (1 + 1e-12)
        positions_m(under_test, BACK, 1000)
        assert under_test.tip_m <= 0
        assert under_test.force_n == 0.0


@settings(deadline=None, max_examples=30)
@given(
    st.lists(commands, max_size=8),
    st.sampled_from([0.3, 2.5, 50.0]),
    st.floats(50, 500),
    st.floats(0.2, 2),
)
def test_a_rotor_at_rest_presses_with_at_most_the_limit(
    sequence: list[tuple[float, int]], limit_n: float, resonance_hz: float, damping: float
) -> None:
    resonance = f"{resonance_hz} Hz"
    under_test = stepper(limit_n, rotor_resonance=resonance, rotor_damping=damping)
    for command, ticks in sequence:
        positions_m(under_test, command, ticks)
    positions_m(under_test, HALT, 500)
    assert 0 <= under_test.force_n <= limit_n * (1 + 1e-9)


@pytest.mark.parametrize("limit_n", [0.3, 2.5])
@pytest.mark.parametrize("backlash", ["3 µm", "20 µm"])
def test_a_rotor_with_backlash_rests_within_its_swing(backlash: str, limit_n: float) -> None:
    under_test = stepper(limit_n, backlash=backlash, rotor_resonance="100 Hz")
    swung_n = [under_test.step(FORWARD) for _ in range(1000)]
    positions_m(under_test, HALT, 500)
    # Backlash keeps a part of the overshoot; the overforce fault bounds the overshoot.
    assert limit_n < under_test.force_n <= min(max(swung_n), 1.05 * limit_n)
