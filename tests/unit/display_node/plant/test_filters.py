"""The delay line and the low-pass."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, lsim

from display_node.plant.filters import DelayLine, LowPass


@pytest.mark.parametrize(
    ("ticks", "expected"),
    [
        (0, [1, 2, 4, 8, 16]),
        (1, [0, 1, 2, 4, 8]),
        (3, [0, 0, 0, 1, 2]),
        (0.25, [0.75, 1.75, 3.5, 7, 14]),
        (1.5, [0, 0.5, 1.5, 3, 6]),
    ],
)
def test_values_return_after_the_delay(ticks: float, expected: list[float]) -> None:
    delay = DelayLine(ticks)
    assert [delay.step(value) for value in (1, 2, 4, 8, 16)] == expected


TICK_S = 1e-3
orders = pytest.mark.parametrize("order", [1, 2, 3, 4])


def run(low_pass: LowPass, values: NDArray[np.float64]) -> NDArray[np.float64]:
    outputs = []
    for value in values.tolist():
        outputs.append(low_pass.output(value))
        low_pass.advance(value)
    return np.array(outputs)


@orders
@pytest.mark.parametrize("corner_hz", [5.0, 40.0, 2000.0])
def test_piecewise_linear_signals_agree_with_lsim(order: int, corner_hz: float) -> None:
    values = np.random.default_rng(1).normal(0, 1, 500)
    values[0] = 0.0
    analog = butter(order, 2 * math.pi * corner_hz, analog=True)
    _, expected, _ = lsim(analog, values, np.arange(500) * TICK_S)
    assert np.abs(run(LowPass(corner_hz, order, TICK_S), values) - expected).max() < 1e-8


@orders
def test_the_gain_at_the_corner_is_minus_3_db(order: int) -> None:
    tick_s, corner_hz = 1e-4, 40.0
    t_s = np.arange(10_000) * tick_s
    outputs = run(LowPass(corner_hz, order, tick_s), np.sin(2 * math.pi * corner_hz * t_s))
    # The last 20 periods, of 250 ticks each.
    rms = math.sqrt(np.mean(outputs[-5000:] ** 2))
    assert 20 * math.log10(rms * math.sqrt(2)) == pytest.approx(10 * math.log10(0.5), abs=0.01)


@orders
def test_an_output_leaves_the_state_unchanged(order: int) -> None:
    low_pass = LowPass(40.0, order, TICK_S)
    run(low_pass, np.linspace(0, 1, 30))
    first = low_pass.output(2.0)
    assert low_pass.output(-3.0) != first == low_pass.output(2.0)


@orders
def test_a_correction_is_added_to_the_state(order: int) -> None:
    low_pass, untouched = LowPass(40.0, order, TICK_S), LowPass(40.0, order, TICK_S)
    start = np.linspace(0, 1, 30)
    run(low_pass, start)
    run(untouched, start)
    changes = [0.1 / (1 + state) for state in range(order)]
    low_pass.correct(changes)
    moved = run(low_pass, np.ones(40)) - run(untouched, np.ones(40))
    state = np.array(changes)
    for difference in moved.tolist():
        assert difference == pytest.approx(float(low_pass.c[0] @ state), rel=1e-7, abs=1e-9)
        state = low_pass.a @ state
