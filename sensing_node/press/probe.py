"""The force loop that presses the probe on the wrist, with limits of its own. Pure.

It closes at the wrist; only set-points cross the network. Whatever they are, reference and speed
stay within the limits. Without fresh ones the loop eases off to a resting force, then leaves the
wrist. A fault is latched, and the probe leaves.
"""

import math
from collections import deque
from typing import Annotated, Final, Literal

from pydantic import Field

from protocol.config.quantities import (
    Metres,
    MetresPerSecond,
    Nanoseconds,
    Newtons,
    NewtonsPerSecond,
)
from protocol.config.scene import Section
from protocol.faults import Fault, FaultKind, Part
from protocol.tissue import StiffeningLaw

ProbeState = Literal["off", "pressing", "easing", "leaving", "fault"]

# The reference stays below the limits by this share, which covers the loop's own error.
FORCE_SHARE: Final = 0.97
SLEW_SHARE: Final = 0.8
# Share of the slew limit at which the force returns after an interruption.
RETURN_SHARE: Final = 0.2
# The reference approaches a set-point with this rate at last, so that the drive's lag does not
# carry the force beyond it.
APPROACH_PER_S: Final = 50.0
# Crossover of the loop where the tissue is as the model. Drive, load cell and step lag by some
# 8 ms together; 120 rad/s, three times as much, leaves a phase margin of 35°.
CROSSOVER_RAD_PER_S: Final = 40.0
# Where readings are old when they are read, the crossover times the whole lag stays below this.
PHASE_RAD: Final = 0.5
# The stiffness is learnt from motions of this length, relative to the model's; a motion of
# KNOWN_AFTER_N counts as much as the assumption that both are equal.
LEARN_NS: Final = 20_000_000
KNOWN_AFTER_N: Final = 0.02
FORGET: Final = 0.98
SOFTEST, STIFFEST = 0.2, 3.0
# Uncertainty of the learnt stiffness, as a factor.
MARGIN: Final = 1.3
# The same delay without the age of readings.
DRIVE_LAG_S: Final = 8e-3
# Delay of drive, load cell and step, by which the tissue has stiffened before it is measured.
LAG_S: Final = 10e-3
# Distance from first touch at which the probe rests off the wrist.
CLEARANCE_M: Final = 2e-3
TOUCH_N: Final = 0.03
# Reference until first touch; the speed of the approach follows from it.
SEEK_N: Final = 0.06
_TIME_NS = Field(ge=50_000_000, le=10_000_000_000)


class ProbeLimits(Section):
    """Limits of the probe: the keys of the `press` table that `ProbeScene` explains."""

    force_limit_n: Annotated[Newtons, Field(gt=0, le=10)] = 3.0
    slew_limit_n_per_s: Annotated[NewtonsPerSecond, Field(gt=0, le=100)] = 25.0
    overforce: Annotated[float, Field(ge=1, le=2)] = 1.25
    max_speed_m_per_s: Annotated[MetresPerSecond, Field(gt=0, le=0.2)] = 0.06
    travel_m: Annotated[Metres, Field(gt=2e-3, le=0.05)] = 0.02
    resting_n: Annotated[Newtons, Field(ge=0, le=1)] = 0.2
    stale_after_ns: Annotated[Nanoseconds, _TIME_NS] = 300_000_000
    leave_after_ns: Annotated[Nanoseconds, _TIME_NS] = 2_000_000_000
    cell_within_ns: Annotated[Nanoseconds, Field(ge=10_000_000, le=100_000_000)] = 50_000_000


class RelativeStiffness:
    """Stiffness of the tissue over that of the model, learnt from the probe's own motion."""

    def __init__(self) -> None:
        self._products = self._squares = KNOWN_AFTER_N**2
        self._began_ns: int | None = None
        self._force_n = self._expected_n = 0.0
        self._learnt = False

    @property
    def ratio(self) -> float:
        """The estimate, between `SOFTEST` and `STIFFEST`."""
        return min(max(self._products / self._squares, SOFTEST), STIFFEST)

    @property
    def greatest(self) -> float:
        """The bound for which speeds are safe."""
        return min(MARGIN * self.ratio, STIFFEST) if self._learnt else STIFFEST

    def observe(self, force_n: float, expected_change_n: float, now_ns: int) -> None:
        """Take a step: the force, and the change of it that the model expects of the motion."""
        if self._began_ns is None or force_n < TOUCH_N:
            self._began_ns, self._force_n, self._expected_n = now_ns, force_n, 0.0
            return
        self._expected_n += expected_change_n
        if now_ns - self._began_ns < LEARN_NS:
            return
        expected_n, change_n = self._expected_n, force_n - self._force_n
        self._began_ns, self._force_n, self._expected_n = now_ns, force_n, 0.0
        # Smaller motions are within the noise of the load cell.
        if abs(expected_n) < KNOWN_AFTER_N:
            return
        self._products = FORGET * self._products + change_n * expected_n
        self._squares = FORGET * self._squares + expected_n * expected_n
        self._learnt = True


class Probe:
    """The controller of the probe's drive: readings in, speed of the drive out.

    faults: latched, the first one first. reference_n: force that the loop follows. hold_down_n:
    measured force without the pulse.
    """

    def __init__(self, limits: ProbeLimits) -> None:
        self._limits, self._law = limits, StiffeningLaw()
        self._relative = RelativeStiffness()
        self._set_point_n = 0.0
        self._set_point_ns: int | None = None
        self._read_ns: int | None = None
        self._last_ns: int | None = None
        self._position_m = 0.0
        self._returning = True
        # Age of the readings, the largest of the last second; references of the last steps.
        self._age_s = 0.0
        self._references: deque[tuple[int, float]] = deque(maxlen=256)
        self.state: ProbeState = "off"
        self.faults: list[Fault] = []
        self.reference_n = self.hold_down_n = 0.0

    def press(self, force_n: float, now_ns: int) -> None:
        """Take a set-point in N; one that is no number, or negative, releases the wrist."""
        self._set_point_n = force_n if force_n > 0 else 0.0
        self._set_point_ns = now_ns

    def fault(self, fault: Fault) -> None:
        """Latch a fault: the probe leaves the wrist until a new start.

        One of the same kind and part as before is not repeated.
        """
        if all(known.identity != fault.identity for known in self.faults):
            self.faults.append(fault)

    def step(
        self, cell_n: float | None, pulse_n: float, position_m: float, now_ns: int, age_ns: int = 0
    ) -> float:
        """Advance to `now_ns` and return the speed in m/s, positive into the wrist.

        cell_n: reading of the load cell, or None without a new one. pulse_n: what the film measures
        at the same time, which the load cell contains. position_m: of the drive; 0 at rest, off the
        wrist. age_ns: time since the newest reading and this position; the loop compares the
        reading with the reference at that time.
        """
        elapsed_s = 0.0 if self._last_ns is None else max(0, now_ns - self._last_ns) * 1e-9
        self._last_ns = now_ns
        self._check(cell_n, position_m, now_ns)
        if cell_n is not None and math.isfinite(cell_n):
            self.hold_down_n = cell_n - pulse_n if math.isfinite(pulse_n) else cell_n
            nominal_n_per_m = self._law.stiffness_n_per_m(self.hold_down_n)
            expected_n = nominal_n_per_m * (position_m - self._position_m)
            self._relative.observe(self.hold_down_n, expected_n, now_ns)
        if math.isfinite(position_m):
            self._position_m = position_m
        slope_n_per_s = self._follow(self._wanted_n(now_ns), elapsed_s)
        self._age_s = max(age_ns * 1e-9, self._age_s * math.exp(-elapsed_s))
        self._references.append((now_ns, self.reference_n))
        while len(self._references) > 1 and self._references[1][0] <= now_ns - age_ns:
            self._references.popleft()
        return self._bounded(self._speed(slope_n_per_s, position_m), position_m)

    def _check(self, cell_n: float | None, position_m: float, now_ns: int) -> None:
        """Latch a fault for a reading that is impossible or missing, or beyond the travel."""
        limits = self._limits
        if self._read_ns is None:
            self._read_ns = now_ns
        if cell_n is not None:
            self._read_ns = now_ns
            most_n = limits.force_limit_n * limits.overforce
            if not math.isfinite(cell_n):
                words = "a reading is no number"
                self.fault(Fault(FaultKind.NOT_A_NUMBER, Part.LOAD_CELL, words, now_ns))
            elif abs(cell_n) > most_n:
                words = f"more than {most_n:.2f} N"
                self.fault(Fault(FaultKind.OVERFORCE, Part.LOAD_CELL, words, now_ns))
        elif now_ns - self._read_ns > limits.cell_within_ns:
            self.fault(Fault(FaultKind.SILENT, Part.LOAD_CELL, "silent", now_ns))
        if not math.isfinite(position_m) or position_m > limits.travel_m:
            words = "beyond its travel"
            self.fault(Fault(FaultKind.FOLLOWING_ERROR, Part.PROBE, words, now_ns))

    def _wanted_n(self, now_ns: int) -> float:
        """Return the force that is wanted now, and set the state."""
        limits, at_ns = self._limits, self._set_point_ns
        age_ns = None if at_ns is None else now_ns - at_ns
        if self.faults:
            self.state = "fault"
        elif age_ns is None or age_ns > limits.leave_after_ns:
            self.state = "off" if self.hold_down_n < TOUCH_N else "leaving"
        elif age_ns > limits.stale_after_ns:
            self.state = "easing"
        else:
            self.state = "pressing"
            return min(self._set_point_n, FORCE_SHARE * limits.force_limit_n)
        self._returning = True
        if self.state == "easing":
            return min(self.reference_n, limits.resting_n)
        return 0.0

    def _follow(self, wanted_n: float, elapsed_s: float) -> float:
        """Move the reference towards a force within the slew limit; return its slope in N/s."""
        most = SLEW_SHARE * self._limits.slew_limit_n_per_s
        missing_n = wanted_n - self.reference_n
        if self.state == "pressing" and self._returning:
            if missing_n > 0:
                most *= RETURN_SHARE
            self._returning = APPROACH_PER_S * abs(missing_n) > most
        # A late step moves the reference no further than an ordinary one.
        elapsed_s = min(elapsed_s, 1 / APPROACH_PER_S)
        slope_n_per_s = min(max(APPROACH_PER_S * missing_n, -most), most)
        self.reference_n += slope_n_per_s * elapsed_s
        if self.hold_down_n < TOUCH_N and self.reference_n > SEEK_N:
            # The probe touches gently, whatever the set-point.
            self.reference_n = SEEK_N
        return slope_n_per_s

    def _speed(self, slope_n_per_s: float, position_m: float) -> float:
        """Return the speed that the loop wants, in m/s."""
        gone = self.state in ("off", "leaving") and self.reference_n < TOUCH_N
        if self.state == "fault" or gone:
            return -CROSSOVER_RAD_PER_S * position_m
        crossover = min(CROSSOVER_RAD_PER_S, PHASE_RAD / (DRIVE_LAG_S + self._age_s))
        slope = crossover * (self._references[0][1] - self.hold_down_n) + slope_n_per_s
        stiffness = self._law.stiffness_n_per_m(self.hold_down_n)
        return slope / (self._relative.ratio * stiffness)

    def _bounded(self, speed_m_per_s: float, position_m: float) -> float:
        """Return the speed within the limits of the drive, of the slew and of the travel."""
        limits = self._limits
        if not math.isfinite(speed_m_per_s) or not math.isfinite(position_m):
            return -limits.max_speed_m_per_s
        soon_n = max(self.hold_down_n, 0.0) + limits.slew_limit_n_per_s * (LAG_S + self._age_s)
        stiffness = self._relative.greatest * self._law.stiffness_n_per_m(soon_n)
        most = min(limits.max_speed_m_per_s, limits.slew_limit_n_per_s / stiffness)
        # Towards its ends the drive is slowed, so that it stops at them.
        into = min(most, max(0.0, CROSSOVER_RAD_PER_S * (limits.travel_m - position_m)))
        return min(max(speed_m_per_s, -most), into)
