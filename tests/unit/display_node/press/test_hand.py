"""The press of a finger: estimated from readings, predicted, and bounded by the loop's gain."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from display_node.press.finger import PressingFinger
from display_node.press.hand import MOST_SHARE, STIFFEST_N_PER_M, FollowingHand
from display_node.press.loop_gain import MOST_GAIN, LoopGain
from display_node.press.reading import PressReading
from protocol.tissue import StiffeningLaw

MS = 1_000_000
YIELD_S = 0.25
TISSUE = StiffeningLaw(length_m=1.2e-3 / 0.3)


class TipAndHand:
    """A hand of some stiffness on a tip that yields, with steps of the force that it means."""

    def __init__(self, stiffness_n_per_m: float) -> None:
        self._finger = PressingFinger(stiffness_n_per_m, pulse_share=0.0, noise_n=2e-3)
        self.hand = FollowingHand()
        self._yielded_m = 0.0
        self._now_ns = 0

    def run(self, meant_n: float, seconds: float) -> list[float]:
        """Return the press of each millisecond."""
        pressed_n = []
        for _ in range(round(1e3 * seconds)):
            self._now_ns += MS
            reading_n = self._finger.step(meant_n, self._yielded_m, 0.0, 1e-3)
            wanted_m = TISSUE.depth_m(reading_n)
            self._yielded_m += (wanted_m - self._yielded_m) * -math.expm1(-1e-3 / YIELD_S)
            self.hand.observe(reading_n, self._yielded_m, self._now_ns)
            pressed_n.append(self._finger.press_n)
        return pressed_n


@pytest.mark.parametrize("stiffness_n_per_m", [90.0, 300.0, 900.0])
@pytest.mark.parametrize("ahead_s", [0.11, 0.56])
def test_the_press_of_a_hand_that_follows_is_predicted(
    stiffness_n_per_m: float, ahead_s: float
) -> None:
    bench = TipAndHand(stiffness_n_per_m)
    for number in range(10):
        bench.run((0.6, 1.2)[number % 2], 4.0)
    now_n = bench.run(0.6, 0.4)[-1]
    change_n = bench.hand.change_n(now_n, TISSUE, YIELD_S, ahead_s)
    later_n = bench.run(0.6, ahead_s)[-1]
    assert abs(later_n - now_n - change_n) < max(0.4 * abs(later_n - now_n), 0.01)


def test_a_prediction_is_bounded_whatever_was_read() -> None:
    hand = FollowingHand()
    for number in range(400):
        hand.observe((0.0, 50.0)[number // 10 % 2], (1e-2, 0.0)[number // 10 % 2], number * MS)
        assert abs(hand.change_n(1.0, TISSUE, YIELD_S, 1e9)) <= MOST_SHARE
    assert 0.0 <= hand.stiffness_n_per_m <= STIFFEST_N_PER_M
    assert hand.change_n(0.0, TISSUE, YIELD_S, 0.5) == 0.0


def test_the_gain_is_that_of_the_worst_sine() -> None:
    """The change that is predicted for a sine in the press is no larger than the bound."""
    hand = FollowingHand()
    compliance = 1 / TISSUE.stiffness_n_per_m(1.0)
    bound = hand.most_gain(compliance, YIELD_S)
    for rate_hz in (0.3, 0.8, 1.25, 3.0, 10.0):
        yielded_m, largest_n = TISSUE.depth_m(1.0), 0.0
        hand = FollowingHand()
        for number in range(6000):
            leak_n = 1e-3 * math.sin(2 * math.pi * rate_hz * 1e-3 * number)
            wanted_m = TISSUE.depth_m(1.0 + leak_n)
            yielded_m += (wanted_m - yielded_m) * -math.expm1(-1e-3 / YIELD_S)
            hand.observe(1.0, yielded_m, number * MS)
            if number > 3000:
                change_n = hand.change_n(1.0, TISSUE, YIELD_S, 0.5)
                largest_n = max(largest_n, abs(change_n))
        assert largest_n <= bound * 1e-3, rate_hz


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


def test_a_press_is_never_negative() -> None:
    _, row = estimated(1.0, 2.0, lambda t_s: -0.5)
    assert row.max() == 0.0


@given(st.floats(0, 4), st.floats(0, 5), st.floats(-5, 5), st.floats(0.2, 3), st.floats(0.2, 3))
def test_the_gain_from_pulse_to_set_point_is_bounded(
    remaining: float, through: float, slope: float, before_n: float, press_n: float
) -> None:
    loop = LoopGain()
    loop.add(0.0, through, slope, 1e-3)
    loop.bound(before_n)
    loop.add(remaining, through, slope, 1e-3)
    # What a newton of hold-down changes in the press by the pulse, and this in the set-point.
    leak_n = 1e-3 * remaining * through * slope
    change_n = loop.bound(press_n + leak_n) - loop.bound(press_n)
    if remaining * through * abs(slope) > MOST_GAIN:
        assert abs(change_n) <= MOST_GAIN * 1e-3 * (1 + 1e-6)
    assert loop.gain <= MOST_GAIN * (1 + 1e-9)
