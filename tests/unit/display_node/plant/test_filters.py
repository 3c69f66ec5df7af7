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
@pytest.mark.parametrize("tick_s", [1e-6, TICK_S, 0.1])
def test_piecewise_linear_signals_agree_with_lsim(
    tick_s: float, order: int, corner_hz: float
) -> None:
    values = np.random.default_rng(1).normal(0, 1, 500)
    values[0] = 0.0
    analog = butter(order, 2 * math.pi * corner_hz, analog=True)
    _, expected, _ = lsim(analog, values, np.arange(500) * tick_s)
    assert np.abs(run(LowPass(corner_hz, order, tick_s), values) - expected).max() < 1e-8
