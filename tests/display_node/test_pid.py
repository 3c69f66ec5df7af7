import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from display_node.controller import ControllerScene
from display_node.pid import Pid

TICK_S = 1e-3
ENDLESS = 1e15


def pid(limit: float = ENDLESS, tick_s: float = TICK_S, **table: object) -> Pid:
    return ControllerScene.model_validate({"kp": 0} | table).pid(tick_s, limit)


def outputs_by_sums(
    errors: NDArray[np.float64], kp: float, ki: float, kd: float, corner_hz: float
) -> NDArray[np.float64]:
    """An unbounded PID without recursion: each output a sum over the whole past."""
    filter_s = 1 / (2 * math.pi * corner_hz)
    fading = (filter_s / (filter_s + TICK_S)) ** np.arange(len(errors))
    changes = np.diff(errors, prepend=errors[0])
    rates = np.array([changes[: k + 1] @ fading[k::-1] for k in range(len(errors))])
    integrals = np.array([errors[: k + 1].sum() for k in range(len(errors))])
    return kp * errors + ki * TICK_S * integrals + kd / (filter_s + TICK_S) * rates


@settings(deadline=None)
@given(
    st.lists(st.floats(-10, 10), min_size=1, max_size=60),
    st.floats(0, 100),
    st.floats(0, 1000),
    st.floats(0, 10),
    st.floats(1, 5000),
)
def test_pid_agrees_with_a_slow_one(
    errors: list[float], kp: float, ki: float, kd: float, corner_hz: float
) -> None:
    under_test = pid(kp=kp, ki=ki, kd=kd, derivative_filter=f"{corner_hz:.6f} Hz")
    expected = outputs_by_sums(np.array(errors), kp, ki, kd, float(f"{corner_hz:.6f}"))
    outputs = [under_test.step(error) for error in errors]
    assert outputs == pytest.approx(expected, rel=1e-9, abs=1e-7)


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), max_size=60))
def test_pid_never_passes_its_limit(steps: list[tuple[float, float]]) -> None:
    under_test = pid(limit=0.4, kp=15, ki=100, kd=0.5)
    for error, feed in steps:
        assert abs(under_test.step(error, feed=feed)) <= 0.4


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("gains", [{"kp": 1, "ki": 50}, {"ki": 50}, {"kp": 0.1, "ki": 500}])
def test_a_long_saturation_leaves_no_windup(gains: dict[str, float], sign: int) -> None:
    under_test = pid(limit=1.0, **gains)
    for _ in range(100_000):
        saturated = under_test.step(sign * 0.5)
    assert sign * saturated == pytest.approx(1.0, abs=0.3)
    assert sign * under_test.step(-sign * 0.5) < 1.0
    # At the limit of its own the integral is worked off again in limit / (ki error).
    ticks = 2 + round(1 / (gains["ki"] * TICK_S * 0.5))
    for _ in range(ticks):
        back = under_test.step(-sign * 0.5)
    assert sign * back < 0


def test_a_saturating_proportion_does_not_charge_the_integral() -> None:
    under_test = pid(limit=1.0, kp=10, ki=100)
    for _ in range(1000):
        assert under_test.step(5.0) == 1.0
    assert under_test.step(0.0) == 0.0


def test_a_saturating_feed_does_not_keep_the_integral_from_unloading() -> None:
    under_test = pid(limit=1.0, ki=100)
    for _ in range(9):
        under_test.step(1.0)
    for _ in range(5):
        assert under_test.step(-1.0, feed=10.0) == 1.0
    assert under_test.step(0.0) == pytest.approx(0.4)


@pytest.mark.parametrize("corner_hz", [10, 100, 1000])
def test_the_derivative_of_a_ramp_is_its_slope(corner_hz: float) -> None:
    under_test = pid(kd=2, derivative_filter=f"{corner_hz} Hz")
    outputs = [under_test.step(3.0 * TICK_S * tick) for tick in range(1000)]
    assert outputs[-1] == pytest.approx(2 * 3.0)
    assert all(0 <= output <= 6.0 + 1e-9 for output in outputs)


def test_the_derivative_is_filtered_at_its_corner() -> None:
    under_test = pid(kd=1, tick_s=1e-5, derivative_filter="100 Hz")
    t_s = np.arange(20_000) * 1e-5
    omega = 2 * math.pi * 100
    outputs = np.array([under_test.step(math.sin(omega * t)) for t in t_s])
    assert outputs[10_000:].max() == pytest.approx(omega / math.sqrt(2), rel=0.01)


def test_the_first_error_gives_no_derivative_kick() -> None:
    assert pid(kd=1).step(5.0) == 0.0


def test_a_constant_error_is_integrated_over_time() -> None:
    under_test = pid(ki=4)
    outputs = [under_test.step(0.5) for _ in range(1000)]
    assert outputs[-1] == pytest.approx(4 * 0.5 * 1.0)


def test_feed_forward_is_added_before_the_limit() -> None:
    assert pid(kp=2).step(0.1, feed=3.0) == pytest.approx(3.2)
    assert pid(limit=1.0, kp=2).step(0.1, feed=3.0) == 1.0
