"""A motor that turns the wrong way, found out before it presses a finger."""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from unittest.mock import Mock

import pytest

from display_node.drives.homing import (
    OPENED_M,
    SEARCH_MARGIN_M,
    SearchBound,
    TouchGuard,
    check_switch,
    opened_m,
    undo_wrong_way,
)
from display_node.drives.tmcl.drive import TmclDrive
from protocol.errors import DriveError
from telepulse.emulators.fault_injection import FaultKind, InjectedFault
from tests.support.drive_benches import Bench, cia402_bench, tmcl_bench
from tests.unit.display_node.drives.test_supervisor import axis

MakeBench = Callable[..., AbstractContextManager[Bench]]


@pytest.mark.parametrize("make", [tmcl_bench, cia402_bench], ids=["tmcl", "cia402"])
@pytest.mark.parametrize("film", [True, False], ids=["film", "no film"])
def test_a_reversed_motor_is_refused_before_it_presses(make: MakeBench, film: bool) -> None:
    """The wires of the shaft are swapped from the start; its drive counts as commanded."""
    with make(touch="2 mm") as bench:
        bench.motor.injector.begin(InjectedFault(FaultKind.REVERSED), time.monotonic_ns())
        peak_n = 0.0

        def force_n() -> float | None:
            nonlocal peak_n
            peak_n = max(peak_n, bench.motor.force_n)
            return bench.motor.force_n if film else None

        with pytest.raises(DriveError) as error:
            bench.drive.start(force_n)
        assert error.value.kind == "wrong way"
        assert "inverted" in str(error.value)
        assert bench.motor.rate_hz == pytest.approx(0.0)
        if film:
            assert peak_n < 0.4
            assert bench.motor.force_n < 0.1


@pytest.mark.parametrize("error", [KeyboardInterrupt(), DriveError("no answer", "it is off")])
def test_a_start_that_is_ended_otherwise_closes_the_drive_where_it_is(error: BaseException) -> None:
    drive, follow = Mock(TmclDrive), Mock()
    with (
        pytest.raises(type(error)),
        undo_wrong_way(drive, axis(), speed_m_per_s=1e-3, follow=follow),
    ):
        raise error
    drive.close.assert_called_once_with()
    follow.assert_not_called()
    drive.command.assert_not_called()


def test_a_film_that_is_pressed_before_first_touch_ends_the_motion() -> None:
    readings = iter([0.30, 0.28, 0.31, None, 0.37, 0.39])
    guard = TouchGuard(lambda: next(readings))
    for _ in range(4):
        guard()
    with pytest.raises(DriveError, match="the film reads 110 mN more before first touch"):
        guard()


def test_a_switch_that_stays_closed_towards_the_finger_is_the_wrong_way() -> None:
    check_switch(False, 0.3e-3)
    check_switch(None, 0.3e-3)
    with pytest.raises(DriveError, match="from home, towards the finger"):
        check_switch(True, 0.3e-3)
    assert opened_m(2e-3) == OPENED_M
    assert opened_m(0.2e-3) == pytest.approx(0.1e-3)


def test_a_search_for_home_goes_no_further_than_home_can_be() -> None:
    ours = axis()
    bound, most_m = SearchBound(ours, 1e-3), ours.furthest_m - ours.lowest_m + SEARCH_MARGIN_M
    bound(1e-3 - 0.99 * most_m)
    for place_m in (1e-3 - 1.01 * most_m, 1e-3 + 1.01 * most_m):
        with pytest.raises(DriveError, match="no home switch on"):
            bound(place_m)
