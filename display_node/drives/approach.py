"""Bringing the tip to a place by speed alone, as any drive can."""

import math
import time
from collections.abc import Callable

from display_node.drives.drive import Drive
from display_node.step_rate import AT_REST, StepCommand
from protocol.errors import DriveError

PERIOD_S = 2e-3
# The way that is left is made in about this long: slower than any drive reports where it is.
TIME_CONSTANT_S = 0.1


def approach(
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
            drive.command(AT_REST)
            sent_m_per_s = 0.0
            if not status.moving:
                return
        else:
            rate_hz = min(speed_m_per_s, max(abs(left_m) / TIME_CONSTANT_S, 10 * step_m)) / step_m
            drive.command(StepCommand(rate_hz, 1 if left_m > 0 else -1))
            sent_m_per_s = math.copysign(rate_hz * step_m, left_m)
        if time.monotonic() > deadline_s:
            text = f"{left_m * 1e3:.3f} mm before first touch, and no nearer"
            raise DriveError("not there", text)
        time.sleep(PERIOD_S)
