"""The press estimated from readings that contain the rendered pulse."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from display_node.press.reading import PressReading

MS = 1_000_000
BEAT_S = 0.8


def beat(time_s: float) -> float:
    """Return a pulse of 0.3 N without mean."""
    phase = (time_s / BEAT_S) % 1.0
    return 0.3 * (math.exp(-0.5 * ((phase - 0.2) / 0.06) ** 2) - 0.1504)


def estimated(
    share: float, seconds: float, press_n: Callable[[float], float], noise_n: float = 2e-3
) -> tuple[PressReading, np.ndarray]:
    reading, random = PressReading(), np.random.default_rng(1)
    reading.beat_ns = round(BEAT_S * 1e9)
    row = []
    for number in range(round(seconds * 1e3)):
        time_s = number * 1e-3
        pulse_n = beat(time_s)
        noise = noise_n * float(random.standard_normal())
        row.append(reading.add(press_n(time_s) + share * pulse_n + noise, pulse_n, number * MS))
    return reading, np.array(row)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0, 3.0])
def test_the_pulses_share_is_learnt_and_nothing_of_it_remains(share: float) -> None:
    reading, press_n = estimated(share, 8.0, lambda t_s: 1.0)
    assert reading.pulse_share == pytest.approx(share, abs=0.02)
    assert np.abs(press_n[5000:] - 1.0).max() < 0.005
    assert reading.remaining < 0.05


@pytest.mark.parametrize("press_n", [0.3, 1.0, 2.0])
def test_a_step_is_followed_within_a_tenth_of_a_second(press_n: float) -> None:
    _, row = estimated(1.0, 8.0, lambda t_s: press_n if t_s < 5.1 else 1.5 * press_n)
    later = row[5200:]
    assert np.abs(later / (1.5 * press_n) - 1).max() < 0.02


def test_a_slow_motion_is_followed_within_a_few_per_cent() -> None:
    _, row = estimated(1.0, 9.0, lambda t_s: 1.0 + 0.2 * max(0.0, t_s - 5))
    truth = 1.0 + 0.2 * np.maximum(0.0, 1e-3 * np.arange(9000) - 5)
    assert np.abs(row[5000:] / truth[5000:] - 1).max() < 0.03


def test_a_press_is_never_negative() -> None:
    _, row = estimated(1.0, 2.0, lambda t_s: -0.5)
    assert row.max() == 0.0


def test_the_pulse_is_scaled_by_a_reading_that_follows_a_step_sooner_than_the_tip() -> None:
    # The step is 20 ms old.
    reading, _ = estimated(1.0, 8.021, lambda t_s: 1.5 if t_s < 8.0 else 0.7)
    assert reading.scaling_n == pytest.approx(0.7, abs=0.03)
    assert reading.now_n > 0.85
