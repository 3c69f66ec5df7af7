"""Verification of the motor's direction, before the tip touches a finger.

A wrong `inverted` or two swapped wires make every withdrawal a press. What the drive counts itself
shows neither, so the home switch and the film are the witnesses.

Bringing the tip to a place by speed alone, as any drive can.
"""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

from display_node.drives.axis import Axis
from display_node.drives.drive import Drive
from protocol.errors import DriveError

PERIOD_S = 2e-3
# The way that is left is made in about this long: slower than any drive reports where it is.
TIME_CONSTANT_S = 0.1


def move_to(
    drive: Drive,
    position_m: float,
    speed_m_per_s: float,
    step_m: float,
    guard: Callable[[], None] = lambda: None,
) -> None:
    """Move to within a step of a position and rest there; blocks.

    guard is called on the way, and may end it by raising. Raises DriveError.
    """
    way_m = abs(position_m - drive.status().position_m)
    steps = max(way_m / step_m, 1.0)
    deadline_s = time.monotonic() + 2.0 + 2 * way_m / speed_m_per_s + math.log(steps)
    sent_m_per_s = 0.0
    while True:
        guard()
        status = drive.status()
        if status.fault is not None:
            raise DriveError("fault", f"on its way to first touch: {status.fault}")
        # On a busy host or line reports are late, and the tip has gone on since.
        age_s = (time.monotonic_ns() - status.heard_ns) * 1e-9
        left_m = position_m - status.position_m - sent_m_per_s * age_s
        if abs(left_m) <= step_m:
            sent_m_per_s = 0.0
            drive.command(0.0)
            if not status.moving:
                return
        else:
            slowest = 10 * step_m
            size = min(speed_m_per_s, max(abs(left_m) / TIME_CONSTANT_S, slowest))
            sent_m_per_s = math.copysign(size, left_m)
            drive.command(sent_m_per_s)
        if time.monotonic() > deadline_s:
            text = f"{left_m * 1e3:.3f} mm before first touch, and no nearer"
            raise DriveError("not there", text)
        time.sleep(PERIOD_S)


# From home towards the finger: further than any switch needs to open.
OPENED_M = 0.3e-3
# Beyond the way from the furthest place of the travel: the switch's own, and what the scene's
# `touch` may be wrong by.
SEARCH_MARGIN_M = 1e-3
# On its way to first touch the tip presses nothing; a film that reads so much more is pressed.
PRESSED_N = 0.1
# Kind of DriveError, and what to do.
WRONG_WAY = "wrong way"
ADVICE = "look at [display.drive] inverted and at the motor's wiring"


class TouchGuard:
    """Ends a motion away from the finger, or up to first touch, on which the film is pressed."""

    def __init__(self, force_n: Callable[[], float | None]) -> None:
        """force_n gives the film's newest reading, None where there is none."""
        self._force_n = force_n
        self._least_n = force_n()

    def __call__(self) -> None:
        """Raise DriveError where the film reads more than the least until now explains."""
        force_n = self._force_n()
        if force_n is None:
            return
        if self._least_n is None or force_n < self._least_n:
            self._least_n = force_n
        elif force_n > self._least_n + PRESSED_N:
            rise_mn = (force_n - self._least_n) * 1e3
            raise DriveError(
                WRONG_WAY, f"the film reads {rise_mn:.0f} mN more before first touch; {ADVICE}"
            )


class SearchBound:
    """Ends a search for home that has gone further than home can be away."""

    def __init__(self, axis: Axis, began_m: float) -> None:
        """began_m: where the search began, by the drive's own count."""
        self._most_m = axis.furthest_m - axis.lowest_m + SEARCH_MARGIN_M
        self._began_m = began_m

    def __call__(self, position_m: float) -> None:
        """Raise DriveError where the drive's count has come too far."""
        if abs(position_m - self._began_m) > self._most_m:
            raise DriveError(
                WRONG_WAY,
                f"no home switch on {self._most_m * 1e3:.1f} mm, from wherever the tip stood;"
                f" {ADVICE}, and at touch and furthest",
            )


@dataclass
class ApproachDirection:
    """A way home or to first touch. began_m: where it began, by the drive's own count."""

    began_m: float


@contextmanager
def undone_where_wrong(
    drive: Drive, axis: Axis, speed_m_per_s: float, follow: Callable[[], None]
) -> Iterator[ApproachDirection]:
    """Close a drive whose start fails; one that went the wrong way goes back before.

    follow makes the drive follow commands, where it does not.
    """
    way = ApproachDirection(axis.lowest_m)
    try:
        yield way
    except BaseException as error:  # Ctrl-C, too, must not leave it moving.
        if isinstance(error, DriveError) and error.kind == WRONG_WAY:
            with suppress(DriveError):  # that it was wrong is raised already
                follow()
                move_to(drive, way.began_m, speed_m_per_s, axis.units.step_m)
        drive.close()
        raise


def approach_touch(
    drive: Drive,
    axis: Axis,
    speed_m_per_s: float,
    home_switch: Callable[[], bool | None],
    guard: Callable[[], None],
) -> None:
    """Go from home to first touch, and see on the way that the home switch opens; blocks.

    home_switch returns whether it is closed, None where that is not known. Raises DriveError.
    """
    home_m, step_m = axis.lowest_m, axis.units.step_m
    opened = opened_m(-home_m)
    move_to(drive, home_m + opened, speed_m_per_s, step_m, guard)
    check_switch(home_switch(), opened)
    move_to(drive, 0.0, speed_m_per_s, step_m, guard)


def opened_m(touch_m: float) -> float:
    """Return how far to go from home, in m, until the home switch must have opened."""
    return min(OPENED_M, touch_m / 2)


def check_switch(closed: bool | None, went_m: float) -> None:
    """Raise DriveError unless the home switch is open so far towards the finger.

    closed is None where the drive does not report its switch: then home itself, which its search
    has found by that switch, is what there is.
    """
    if closed:
        raise DriveError(
            WRONG_WAY,
            f"the home switch is closed {went_m * 1e3:.2g} mm from home, towards the finger;"
            f" {ADVICE}",
        )
