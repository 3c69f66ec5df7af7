"""Commanded position of a drive, and the following error of the reported position.

The following error (CiA 402's term) is the distance between the two. Pure: times are arguments in
ns on the monotonic clock.
"""

import math
from collections import deque
from typing import NamedTuple

# Speed changes that are kept: 128 ms of a 1 kHz loop.
LEGS = 128
# Greatest time from a command to a report that shows it: the drive's reaction and the report's age.
LATE_NS = 30_000_000
# Tolerated distance from the positions that were commanded within LATE_NS; 150 mN at 1 N/mm.
TOLERANCE_M = 150e-6
# A larger error is a fault after this time; a single report may be wrong.
WITHIN_NS = 20_000_000
# Commands take effect somewhat early or late, and no drive ramps exactly as commanded. So the
# origin follows the reports, by these constants of time and travel: 7 % of the travel is tolerated.
DRIFT_S = 5.0
DRIFT_M = 2e-3


class _Leg(NamedTuple):
    """A change of speed: its time, travel in m and speed in m/s by then, and the speed sent."""

    sent_ns: int
    travel_m: float
    speed: float
    sent: float

    def after(self, seconds: float, acceleration: float) -> tuple[float, float]:
        """Return travel in m and speed in m/s some seconds later."""
        change = self.sent - self.speed
        ramp_s = abs(change) / acceleration
        if seconds < ramp_s:
            reached = self.speed + math.copysign(acceleration * seconds, change)
            return self.travel_m + 0.5 * (self.speed + reached) * seconds, reached
        ramped_m = 0.5 * (self.speed + self.sent) * ramp_s
        return self.travel_m + ramped_m + self.sent * (seconds - ramp_s), self.sent


class CommandedPosition:
    """Integral of the speeds sent to a drive, each reached by a ramp; its origin is arbitrary.

    held_ns: time in ns for which the drive keeps a speed that is not sent again; then it brakes.
    """

    def __init__(self, acceleration_m_per_s2: float = math.inf, held_ns: float = math.inf) -> None:
        self._acceleration, self._held_ns = acceleration_m_per_s2, held_ns
        self._legs: deque[_Leg] = deque([_Leg(0, 0.0, 0.0, 0.0)], maxlen=LEGS)
        # Time at which a speed was last sent, be it the same as before.
        self._renewed_ns = 0

    def record(self, speed_m_per_s: float, now_ns: int) -> None:
        """Record a speed that was sent at a time; it may be the same as the last one."""
        last = self._legs[-1]
        # A thread that stalled may record its command after another thread's newer one.
        now_ns = max(now_ns, last.sent_ns)
        if now_ns - self._renewed_ns > self._held_ns and last.sent:
            last = self._braked(last)
            self._legs.append(last)
        self._renewed_ns = now_ns
        if speed_m_per_s != last.sent:
            travel_m, speed = last.after((now_ns - last.sent_ns) * 1e-9, self._acceleration)
            self._legs.append(_Leg(now_ns, travel_m, speed, speed_m_per_s))

    def _braked(self, last: _Leg) -> _Leg:
        """Return the leg that begins when the last speed is no longer kept."""
        held_ns = self._renewed_ns + int(self._held_ns) - last.sent_ns
        travel_m, speed = last.after(held_ns * 1e-9, self._acceleration)
        return _Leg(last.sent_ns + held_ns, travel_m, speed, 0.0)

    def travel_m(self, now_ns: int) -> float:
        """Return the travel in m until a time; before all kept speeds, that at the earliest."""
        if now_ns - self._renewed_ns > self._held_ns:
            leg = self._legs[-1]
            leg = self._braked(leg) if leg.sent else leg
            return leg.after((now_ns - leg.sent_ns) * 1e-9, self._acceleration)[0]
        # By index, as another thread may record meanwhile (`TimeoutLock`).
        for back in range(1, len(self._legs) + 1):
            leg = self._legs[-back]
            if now_ns >= leg.sent_ns:
                return leg.after((now_ns - leg.sent_ns) * 1e-9, self._acceleration)[0]
        return self._legs[0].travel_m

    def bounds_m(self, from_ns: int, to_ns: int) -> tuple[float, float]:
        """Return the least and greatest travel in m at two times and the commands between them."""
        travels = [self.travel_m(from_ns), self.travel_m(to_ns)]
        travels += [leg.travel_m for leg in tuple(self._legs) if from_ns < leg.sent_ns < to_ns]
        return min(travels), max(travels)


class FollowingError:
    """Comparison of reported positions with the commanded one.

    The first report after `begin` fixes the origin of the travel. held_ns: see `CommandedPosition`.

    Attributes
    ----------
    error_m
        Signed error of the last report in m, beyond the range commanded within LATE_NS.
    failed
        True once the error has exceeded TOLERANCE_M for WITHIN_NS.
    """

    def __init__(self, acceleration_m_per_s2: float, held_ns: float = math.inf) -> None:
        self._commanded = CommandedPosition(acceleration_m_per_s2, held_ns)
        self.begin()

    def begin(self) -> None:
        """Discard all reports."""
        self._origin_m = math.nan
        self._last_m = 0.0
        self._last_ns = self._good_ns = 0
        self.error_m = 0.0
        self.failed = False

    def record(self, speed_m_per_s: float, now_ns: int) -> None:
        """Record a speed that was sent at a time."""
        self._commanded.record(speed_m_per_s, now_ns)

    def position_m(self, now_ns: int) -> float:
        """Return the commanded position in m from first touch; NaN before the first report."""
        return self._origin_m + self._commanded.travel_m(now_ns)

    def add_position(self, position_m: float, received_ns: int) -> None:
        """Take a reported position in m from first touch, and when it was received."""
        commanded_m = self._commanded.travel_m(received_ns)
        if math.isnan(self._origin_m):
            self._origin_m = position_m - commanded_m
            self._good_ns = received_ns
        else:
            low_m, high_m = self._commanded.bounds_m(received_ns - LATE_NS, received_ns)
            travel_m = position_m - self._origin_m
            self.error_m = travel_m - min(max(travel_m, low_m), high_m)
            drift = (received_ns - self._last_ns) * 1e-9 / DRIFT_S
            drift += abs(commanded_m - self._last_m) / DRIFT_M
            self._origin_m += self.error_m * min(drift, 1.0)
        self._last_ns, self._last_m = received_ns, commanded_m
        if abs(self.error_m) <= TOLERANCE_M:
            self._good_ns = received_ns
        elif received_ns - self._good_ns >= WITHIN_NS:
            self.failed = True
