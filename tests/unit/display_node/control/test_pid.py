import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from display_node.control.pid import Pid
from display_node.control.scene import ControllerScene
from display_node.plant.scene import SecondOrderScene
from display_node.plant.second_order import SecondOrder
from protocol.tactile import Film

TICK_S = 1e-3
ENDLESS = 1e15


def pid(limit: float = ENDLESS, tick_s: float = TICK_S, **table: object) -> Pid:
    return ControllerScene.model_validate({"kp": 0} | table).pid(tick_s, limit)


def outputs_by_sums(
    errors: NDArray[np.float64], kp: float, ki: float, kd: float, corner_hz: float
) -> NDArray[np.float64]:
    """Return the outputs of an unbounded PID, each as a sum over the whole past."""
    filter_s = 1 / (2 * math.pi * corner_hz)
    fading = (filter_s / (filter_s + TICK_S)) ** np.arange(len(errors))
    changes = np.diff(errors, prepend=errors[0])
    rates = np.array([changes[: k + 1] @ fading[k::-1] for k in range(len(errors))])
    integrals = np.array([errors[: k + 1].sum() for k in range(len(errors))])
    return kp * errors + ki * TICK_S * integrals + kd / (filter_s + TICK_S) * rates


def test_under_saturation_the_integral_may_only_unload() -> None:
    under_test = pid(limit=1.0, kp=10, ki=100)
    for _ in range(1000):
        assert under_test.step(5.0) == 1.0
    assert under_test.step(0.0) == 0.0
    under_test = pid(limit=1.0, ki=100)
    for _ in range(9):
        under_test.step(1.0)
    for _ in range(5):
        assert under_test.step(-1.0, feed_forward=10.0) == 1.0
    assert under_test.step(0.0) == pytest.approx(0.4)


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.floats(-10, 10), st.floats(-10, 10)), min_size=1, max_size=60),
    st.floats(0, 100),
    st.floats(0, 1000),
    st.floats(0, 1),
    st.floats(1, 5000),
    st.just(0.0) | st.floats(1e-6, 10),
)
def test_the_law_holds_for_the_error_at_the_ticks_end(
    steps: list[tuple[float, float]],
    kp: float,
    ki: float,
    kd: float,
    corner_hz: float,
    response: float,
) -> None:
    under_test = pid(kp=kp, ki=ki, kd=kd, derivative_filter=f"{corner_hz:.6f} Hz")
    outputs = np.array([under_test.step(error, response, feed) for error, feed in steps])
    errors, feeds = np.array(steps).T
    remaining = errors - response * outputs
    # The derivative's past begins with the first error, before the first output.
    past_and_remaining = np.concatenate([errors[:1], remaining])
    expected = outputs_by_sums(past_and_remaining, kp, ki, kd, float(f"{corner_hz:.6f}"))[1:]
    expected -= ki * TICK_S * errors[0]
    scale = 1 + np.abs(outputs).max() * (1 + kp + ki + 1e3 * kd) * (1 + response)
    assert outputs == pytest.approx(expected + feeds, abs=1e-9 * scale)


@pytest.mark.parametrize("response", [1e-3, 0.05])
def test_after_saturation_the_response_is_that_of_a_fresh_start(response: float) -> None:
    def from_afar(error: float) -> list[float]:
        """Return the error of a plant that integrates its commands, after each tick."""
        under_test, errors = pid(limit=1.0, kp=5, ki=20), []
        for _ in range(3001):
            error -= response * under_test.step(error, response)
            errors.append(error)
        return errors

    far = 2 + 500 * response
    all_the_way = from_afar(far)
    # None of the 500 ticks at the bound has charged the integral.
    at_bound = [far - response * tick for tick in range(1, 501)]
    assert all_the_way[:500] == pytest.approx(at_bound)
    assert all_the_way[500:] == pytest.approx(from_afar(at_bound[-1])[:-500], abs=1e-9)
    assert min(all_the_way) < 0
    assert abs(all_the_way[-1]) < 0.02 * far


@settings(deadline=None)
@given(
    st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), max_size=60),
    st.just(0.0) | st.floats(0, 1e6),
)
def test_no_output_exceeds_the_limit(steps: list[tuple[float, float]], response: float) -> None:
    under_test = pid(limit=0.4, kp=15, ki=100, kd=0.5)
    for error, feed in steps:
        assert abs(under_test.step(error, response, feed)) <= 0.4


@pytest.mark.parametrize("response", [0.0, 1e-3])
def test_an_error_that_is_no_number_retracts_and_is_not_remembered(response: float) -> None:
    errors = np.random.default_rng(4).normal(0, 1, 50).tolist()
    under_test = pid(limit=1e4, kp=15, ki=100, kd=0.5)
    undisturbed = pid(limit=1e4, kp=15, ki=100, kd=0.5)
    assert under_test.step(math.nan, response) == -1e4
    for error in errors:
        assert under_test.step(error, response) == undisturbed.step(error, response)
        assert under_test.step(math.nan, response, feed_forward=3.0) == -1e4


PAPERS_SIMULATION = {"kp": 13, "ki": 0.85, "kd": 0.5}
PAPERS_EXPERIMENT = {"kp": 15, "ki": 0.15, "kd": 0.03}
MILLIVOLTS_PER_NEWTON = 1e3 * Film(9e-3).volts_per_newton
WANTED_N = 0.3


def paper_actuator(tick_s: float) -> SecondOrder:
    return SecondOrder(SecondOrderScene.model_validate({"kind": "second_order"}), tick_s)


@pytest.mark.parametrize("derivative_filter", ["100 Hz", "1 kHz"])
@pytest.mark.parametrize("rate_hz", [100, 300, 1000, 3000, 10_000])
@pytest.mark.parametrize("gains", [PAPERS_SIMULATION, PAPERS_EXPERIMENT])
def test_the_papers_gains_are_stable_at_every_rate(
    gains: dict[str, float], rate_hz: int, derivative_filter: str
) -> None:
    tick_s = 1 / rate_hz
    under_test = pid(tick_s=tick_s, derivative_filter=derivative_filter, **gains)
    actuator = paper_actuator(tick_s)
    forces_n = []
    for _ in range(rate_hz):
        error_mv = MILLIVOLTS_PER_NEWTON * (WANTED_N - actuator.force_n - actuator.drift())
        volts = under_test.step(error_mv, MILLIVOLTS_PER_NEWTON * actuator.response)
        forces_n.append(actuator.step(volts))
    assert min(forces_n) > 0
    # With the experiment's gains, a jump overshoots by a third.
    assert max(forces_n) < 1.35 * WANTED_N
    assert max(abs(force_n - WANTED_N) for force_n in forces_n[rate_hz // 2 :]) < 1e-3


@pytest.mark.parametrize("response", [0.0, 1e-3])
def test_an_error_within_the_dead_band_counts_as_zero_besides_the_feed(response: float) -> None:
    under_test = pid(kp=100, ki=50, kd=0.1, dead_band=0.01)
    assert [under_test.step(error, response) for error in (0.01, -0.01, 0.004)] == [0.0] * 3
    assert under_test.step(0.011, response) > 0
    under_test = pid(kp=100, dead_band=0.01)
    # The feed-forward removes an error of 2 within the tick; the rest is within the dead band.
    for error in (2.0, 2.005):
        assert under_test.step(error, 1e-3, feed_forward=2000.0) == pytest.approx(2000.0)
    assert under_test.step(2.5, 1e-3, feed_forward=2000.0) > 2000.0
