import pytest

from pulse_drives.following_error import CommandedPosition

MS = 1_000_000


def test_the_commanded_travel_is_the_integral_of_the_speeds_sent() -> None:
    commanded = CommandedPosition()
    commanded.record(2e-3, 10 * MS)
    commanded.record(-1e-3, 13 * MS)
    expected_um = {5: 0, 12: 4, 13: 6, 15: 4}
    assert {ms: 1e6 * commanded.travel_m(ms * MS) for ms in expected_um} == pytest.approx(
        expected_um
    )
    commanded.record(5e-3, 14 * MS)
    assert commanded.travel_m(14 * MS) == pytest.approx(5e-6)
