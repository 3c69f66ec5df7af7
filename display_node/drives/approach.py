"""Bringing the tip to first touch and off the finger again, by speed alone, as any drive can."""

import math
import time

from display_node.drives.drive import Drive
from display_node.step_rate import AT_REST, StepCommand
from protocol.errors import DriveError

PERIOD_S = 2e-3
# The way that is left is made in about this long: slower than any drive reports where it is.
TIME_CONSTANT_S = 0.1
# Away from the finger: 0.3 mm, a usual pulse's travel, in some 15 ms.
WITHDRAW_M_PER_S = 0.02
# Here nothing is touched, as far as first touch is known.
CLEAR_M = -0.5e-3
CLEAR_WITHIN_S = 0.5


def approach(drive: Drive, position_m: float, speed_m_per_s: float, step_m: float) -> None:
    """Move to within a step of a position and rest there; blocks. Raises DriveError."""
    way_m = abs(position_m - drive.status().position_m)
    steps = max(way_m / step_m, 1.0)
    deadline_s = time.monotonic() + 2.0 + 2 * way_m / speed_m_per_s + math.log(steps)
    while True:
        status = drive.status()
        if status.fault is not None:
            raise DriveError("fault", f"on its way to first touch: {status.fault}")
        left_m = position_m - status.position_m
        if abs(left_m) <= step_m:
            drive.command(AT_REST)
            if not status.moving:
                return
        else:
            rate_hz = min(speed_m_per_s, max(abs(left_m) / TIME_CONSTANT_S, 10 * step_m)) / step_m
            drive.command(StepCommand(rate_hz, 1 if left_m > 0 else -1))
        if time.monotonic() > deadline_s:
            text = f"{left_m * 1e3:.3f} mm before first touch, and no nearer"
            raise DriveError("not there", text)
        time.sleep(PERIOD_S)


def withdraw(drive: Drive, step_m: float) -> None:
    """Take the tip off the finger, if the drive still obeys; blocks, half a second at most."""
    deadline_s = time.monotonic() + CLEAR_WITHIN_S
    while time.monotonic() < deadline_s:
        status = drive.status()
        if status.fault is not None or status.position_m <= CLEAR_M:
            break
        drive.command(StepCommand(WITHDRAW_M_PER_S / step_m, -1))
        time.sleep(PERIOD_S)
    drive.command(AT_REST)
