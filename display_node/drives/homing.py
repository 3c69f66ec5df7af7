"""Homing and the approach to first touch, on which the motor's direction is verified.

A wrong `inverted` or two swapped wires make every withdrawal a press. The drive's own count shows
neither, so the home switch and the film have to.
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
# Time constant of the approach: slower than any drive reports its position.
TIME_CONSTANT_S = 0.1


def move_to(
    drive: Drive,
    position_m: float,
    speed_m_per_s: float,
    step_m: float,
    guard: Callable[[], None] = lambda: None,
) -> None:
    """Move to within a step of a position by speed commands, and rest there; blocks.

    guard is called all along, and may end the motion by raising. Raises DriveError.
    """
    travel_m = abs(position_m - drive.status().position_m)
    steps = max(travel_m / step_m, 1.0)
    deadline_s = time.monotonic() + 2.0 + 2 * travel_m / speed_m_per_s + math.log(steps)
    sent_m_per_s = 0.0
    while True:
        guard()
        status = drive.status()
        if status.fault is not None:
            raise DriveError("fault", f"on its way to first touch: {status.fault}")
        # On a busy host or line reports are late, and the tip has gone on since.
        age_s = (time.monotonic_ns() - status.received_ns) * 1e-9
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
# Beyond the whole travel: the switch's own, and the error of the scene's `touch`.
SEARCH_MARGIN_M = 1e-3
# Up to first touch the tip presses nothing; a film that reads so much more is pressed.
PRESSED_N = 0.1
# Kind of DriveError, and what to do.
WRONG_WAY = "wrong way"
ADVICE = "look at [display.drive] inverted and at the motor's wiring"


class TouchGuard:
    """End of a motion away from the finger, or up to first touch, that presses the film."""

    def __init__(self, force_n: Callable[[], float | None]) -> None:
        """Take a function that returns the film's newest reading in N, None without one."""
        self._force_n = force_n
        self._least_n = force_n()

    def __call__(self) -> None:
        """Raise DriveError where the film reads much more than its least reading until now."""
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
    """End of a search for home that has gone further than home can be away."""

    def __init__(self, axis: Axis, began_m: float) -> None:
        """Begin at a position in m by the drive's own count."""
        self._most_m = axis.furthest_m - axis.lowest_m + SEARCH_MARGIN_M
        self._began_m = began_m

    def __call__(self, position_m: float) -> None:
        """Raise DriveError where the drive has counted too far."""
        if abs(position_m - self._began_m) > self._most_m:
            raise DriveError(
                WRONG_WAY,
                f"no home switch on {self._most_m * 1e3:.1f} mm, from wherever the tip stood;"
                f" {ADVICE}, and at touch and furthest",
            )


@dataclass
class ApproachStart:
    """Beginning of a motion home or to first touch, in m by the drive's own count."""

    began_m: float


@contextmanager
def undo_wrong_way(
    drive: Drive, axis: Axis, speed_m_per_s: float, follow: Callable[[], None]
) -> Iterator[ApproachStart]:
    """Close a drive whose start fails; one that went the wrong way goes back before.

    follow: makes the drive follow commands, where it does not.
    """
    start = ApproachStart(axis.lowest_m)
    try:
        yield start
    except BaseException as error:  # Ctrl-C, too, must not leave it moving.
        if isinstance(error, DriveError) and error.kind == WRONG_WAY:
            with suppress(DriveError):  # the first error is raised anyway
                follow()
                move_to(drive, start.began_m, speed_m_per_s, axis.units.step_m)
        drive.close()
        raise


def approach_touch(
    drive: Drive,
    axis: Axis,
    speed_m_per_s: float,
    home_switch: Callable[[], bool | None],
    guard: Callable[[], None],
) -> None:
    """Go from home to first touch, and check that the home switch opens meanwhile; blocks.

    home_switch returns whether it is closed, None where that is not known. Raises DriveError.
    """
    home_m, step_m = axis.lowest_m, axis.units.step_m
    opened = opened_m(-home_m)
    move_to(drive, home_m + opened, speed_m_per_s, step_m, guard)
    check_switch(home_switch(), opened)
    move_to(drive, 0.0, speed_m_per_s, step_m, guard)


def opened_m(touch_m: float) -> float:
    """Return the distance from home in m within which the home switch must open."""
    return min(OPENED_M, touch_m / 2)


def check_switch(closed: bool | None, went_m: float) -> None:
    """Raise DriveError where the home switch is closed so far towards the finger.

    closed is None where the drive does not report its switch; that its search has found home by
    the switch is then the only evidence.
    """
    if closed:
        raise DriveError(
            WRONG_WAY,
            f"the home switch is closed {went_m * 1e3:.2g} mm from home, towards the finger;"
            f" {ADVICE}",
        )
