import pytest
from hypothesis import given
from hypothesis import strategies as st

from display_node.drives.axis import LARGEST, Units
from display_node.plant.stepper import StepCommand

UNITS = Units(step_m=1e-6, per_step=4.0, per_step_rate=0.5, direction=-1, home_m=-2e-3)


def test_a_rate_goes_to_the_drive_in_its_units_and_direction() -> None:
    assert UNITS.signed(StepCommand(3000.0, 1)) == pytest.approx(3e-3)
    assert UNITS.velocity(3e-3) == -1500
    assert UNITS.speed_m_per_s(-1500) == pytest.approx(3e-3)


def test_positions_count_from_home_and_mean_metres_from_first_touch() -> None:
    assert UNITS.position_m(0) == pytest.approx(-2e-3)
    assert UNITS.position_m(-8000) == pytest.approx(0.0)
    assert UNITS.position(0.0) == -8000


@given(st.floats(-1e6, 1e6))
def test_no_number_overflows_what_a_drive_can_take(value: float) -> None:
    assert abs(UNITS.velocity(value)) <= LARGEST
    assert abs(UNITS.position(value)) <= LARGEST
