import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from display_node.press.loop_gain import GAIN_S, MOST_GAIN, LoopGain


def test_a_low_gain_lets_the_press_through() -> None:
    loop = LoopGain()
    loop.add(0.01, 0.3, 0.9, 1e-3)
    assert loop.gain == pytest.approx(0.0027)
    assert loop.bound(1.2) == 1.2
    loop.add(0.0, 0.3, 0.9, GAIN_S)
    assert loop.gain == pytest.approx(0.0027 * math.exp(-1))


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


def test_the_set_point_begins_at_that_of_a_low_gain_and_returns_to_the_press() -> None:
    loop = LoopGain()
    loop.add(0.01, 0.3, 0.9, 1e-3)
    assert loop.bound(1.0) == 1.0
    loop.add(2 * MOST_GAIN, 1.0, 1.0, 1e-3)
    assert loop.bound(2.0) == pytest.approx(1.5)
    # It does not creep on to the press while the gain is high.
    assert loop.bound(2.0) == pytest.approx(1.5)
    loop.add(0.01, 0.3, 0.9, 1e-3)
    assert loop.bound(2.0) == 2.0
