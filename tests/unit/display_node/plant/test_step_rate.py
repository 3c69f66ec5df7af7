import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from display_node.plant.stepper import StepRate


@pytest.mark.parametrize(
    ("output", "rate_hz", "direction"),
    [
        (0.002, 400.0, 1),
        (-0.002, 400.0, -1),
        (0.05, 10_000.0, 1),
        (0.06, 10_000.0, 1),
        (-math.inf, 10_000.0, -1),
        (0.0, 0.0, 0),
    ],
)
def test_magnitude_is_the_rate_and_sign_the_direction(
    output: float, rate_hz: float, direction: int
) -> None:
    command = StepRate(200_000.0, 10_000.0).command(output)
    assert command.rate_hz == pytest.approx(rate_hz)
    assert command.direction == direction


@settings(deadline=None)
@given(st.floats(allow_nan=False), st.floats(0, 1e6))
def test_a_rate_is_never_negative_nor_above_its_bound(output: float, max_rate_hz: float) -> None:
    command = StepRate(1e5, max_rate_hz).command(output)
    assert 0 <= command.rate_hz <= max_rate_hz
    assert command.direction == (math.copysign(1, output) if output else 0)


def test_the_smallest_output_moves() -> None:
    assert StepRate(1e5, 1e6).command(1e-300).direction == 1
