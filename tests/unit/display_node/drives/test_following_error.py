import pytest

from display_node.drives.following_error import CommandedPosition

MS = 1_000_000


def test_the_way_is_the_sum_of_what_was_told() -> None:
    way = CommandedPosition()
    assert way.travel_m(5 * MS) == 0
    way.record(2e-3, 10 * MS)
    way.record(-1e-3, 13 * MS)
    assert way.travel_m(13 * MS) == pytest.approx(6e-6)
    assert way.travel_m(15 * MS) == pytest.approx(4e-6)


def test_a_time_before_the_last_command_is_still_of_the_one_before() -> None:
    way = CommandedPosition()
    way.record(2e-3, 10 * MS)
    way.record(-1e-3, 13 * MS)
    assert way.travel_m(12 * MS) == pytest.approx(4e-6)
    way.record(5e-3, 14 * MS)
    assert way.travel_m(14 * MS) == pytest.approx(5e-6)
