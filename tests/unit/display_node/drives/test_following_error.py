import pytest

from display_node.drives.following_error import CommandedPosition

MS = 1_000_000


def test_the_commanded_travel_is_the_integral_of_the_speeds_sent() -> None:
    commanded = CommandedPosition()
    assert commanded.travel_m(5 * MS) == 0
    commanded.record(2e-3, 10 * MS)
    commanded.record(-1e-3, 13 * MS)
    assert commanded.travel_m(13 * MS) == pytest.approx(6e-6)
    assert commanded.travel_m(15 * MS) == pytest.approx(4e-6)


def test_a_time_before_the_last_command_belongs_to_the_one_before() -> None:
    commanded = CommandedPosition()
    commanded.record(2e-3, 10 * MS)
    commanded.record(-1e-3, 13 * MS)
    assert commanded.travel_m(12 * MS) == pytest.approx(4e-6)
    commanded.record(5e-3, 14 * MS)
    assert commanded.travel_m(14 * MS) == pytest.approx(5e-6)
