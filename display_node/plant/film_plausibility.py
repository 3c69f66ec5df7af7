"""Plausibility of the film's readings: of each, of their slope, and against the drive's positions.

All reasons to stop using the film are here, in one table, `FilmFault`. Pure: times are arguments in
ns on the monotonic clock.
"""

import math
from collections import deque
from enum import Enum

from display_node.plant.scene import StepperScene
from protocol.faults import Fault, FaultKind, Part
from protocol.tactile import ElasticLayer


class FilmFault(Enum):
    """Reasons to stop using the film, with the words of each. Each ends the pulse."""

    NOT_A_NUMBER = FaultKind.NOT_A_NUMBER, "feedback is not a number"
    OVERFORCE = FaultKind.OVERFORCE, "felt force above {limit:.3g} N"
    SILENT = FaultKind.SILENT, "feedback lost"
    LATE = (
        FaultKind.LATE,
        "feedback late: readings are {least_ms:.0f} ms old or older, not {assumed_ms:.0f} ms",
    )
    RISING = (
        FaultKind.RISING,
        "felt force rises by {slope:.0f} N/s at {force:.2f} N, faster than commanded",
    )
    TOO_LOW = (
        FaultKind.TOO_LOW,
        "it reads {mn:.0f} mN where the tip presses with {least_mn:.0f} mN at least",
    )
    OFF_FINGER = (
        FaultKind.OFF_FINGER,
        "it reads {mn:.0f} mN where the tip is {off_mm:.1f} mm off the finger",
    )
    FROZEN = (
        FaultKind.FROZEN,
        "it reads {mn:.0f} mN unchanged over {travel_mm:.2f} mm of the tip's travel",
    )

    def at(self, now_ns: int, **figures: float) -> Fault:
        """Return the fault, detected at a time, with its figures."""
        kind, words = self.value
        return Fault(kind, Part.FILM, words.format(**figures), now_ns)


# Time over which a slope is computed.
SLOPE_NS = 8_000_000
# Time from a reading until the motor has reversed, without the film's own latency.
REACTION_S = 10e-3


class RisingForce:
    """Prediction of a felt force above the fault's bound early enough to reverse the motor.

    The loop's own commands rise no faster than the slew limit, and stop at the force limit. A
    faster rise comes from a drive that moves further than commanded.
    """

    def __init__(self, overforce_n: float, slew_limit_n_per_s: float, latency_ns: int) -> None:
        self._overforce_n = overforce_n
        self._slew_limit_n_per_s = slew_limit_n_per_s
        self._ahead_s = REACTION_S + latency_ns * 1e-9
        self._samples: deque[tuple[int, float]] = deque()

    def check_reading(self, force_n: float, taken_ns: int) -> Fault | None:
        """Take a reading in N; return the fault that it predicts, if any."""
        samples = self._samples
        samples.append((taken_ns, force_n))
        while len(samples) > 1 and taken_ns - samples[1][0] >= SLOPE_NS:
            samples.popleft()
        began_ns, began_n = samples[0]
        if taken_ns - began_ns < SLOPE_NS:
            return None
        slope = (force_n - began_n) / ((taken_ns - began_ns) * 1e-9)
        beyond = slope - self._slew_limit_n_per_s
        if beyond <= 0 or force_n + beyond * self._ahead_s <= self._overforce_n:
            return None
        return FilmFault.RISING.at(taken_ns, slope=slope, force=force_n)


# The softest finger, as a share of the scene's `fingertip`. Fingertips are 0.5 to 5 N/mm.
SOFTEST = 0.25
# Tolerance of the finger's place: it may lie lower than the scene's `touch`, or follow the tip.
PLACE_M = 0.5e-3
# Tolerance for the film's noise and zero error.
MARGIN_N = 0.05
# Positions and readings may differ in age by this time, so a contradiction must last longer.
WITHIN_NS = 50_000_000
# A film is frozen if its reading stays exactly the same while the pressing tip moves this far.
MOVED_M = 0.15e-3


class FilmPlausibility:
    """Comparison of the film's readings with the positions of the last 50 ms.

    If a broken film reads zero, the loop presses on. The contact law of the softest human finger
    gives the least force at a position; a lower reading is wrong. With the tip far off the finger,
    the film must read zero.
    """

    def __init__(self, actuator: StepperScene, layer: ElasticLayer) -> None:
        softest = actuator.model_copy(
            update={"fingertip_n_per_m": SOFTEST * actuator.fingertip_n_per_m}
        )
        self._law = softest.contact(layer)
        self._positions: deque[tuple[int, float]] = deque()
        self._plausible_ns = 0
        # The last reading, and the range of the pressing tip's positions since it last changed.
        self._same_n = math.nan
        self._low_m = self._high_m = 0.0

    def add_position(self, position_m: float, received_ns: int) -> None:
        """Take a position of the drive in m from first touch."""
        positions = self._positions
        if not positions or received_ns > positions[-1][0]:
            positions.append((received_ns, position_m))
        while received_ns - positions[0][0] > WITHIN_NS:
            positions.popleft()

    def check_reading(self, force_n: float, taken_ns: int) -> Fault | None:
        """Take a reading in N; return the fault once it has contradicted positions for 50 ms."""
        places = [position_m for _, position_m in self._positions]
        fault = None
        if places:
            fault = self._contradiction(force_n, min(places), max(places), taken_ns)
            fault = fault or self._frozen(force_n, max(places[-1], PLACE_M), taken_ns)
        if fault is None or not self._plausible_ns:
            self._plausible_ns = taken_ns
        return fault if taken_ns - self._plausible_ns > WITHIN_NS else None

    def _contradiction(
        self, force_n: float, lowest_m: float, highest_m: float, taken_ns: int
    ) -> Fault | None:
        if lowest_m > self._law.position(max(force_n, 0.0) + MARGIN_N) + PLACE_M:
            least_mn = self._law.force(lowest_m - PLACE_M) * 1e3
            return FilmFault.TOO_LOW.at(taken_ns, mn=force_n * 1e3, least_mn=least_mn)
        if highest_m < -2 * PLACE_M and force_n > 2 * MARGIN_N:
            off_mm = -highest_m * 1e3
            return FilmFault.OFF_FINGER.at(taken_ns, mn=force_n * 1e3, off_mm=off_mm)
        return None

    def _frozen(self, force_n: float, pressing_m: float, taken_ns: int) -> Fault | None:
        if force_n != self._same_n:
            self._same_n, self._low_m, self._high_m = force_n, pressing_m, pressing_m
        self._low_m, self._high_m = min(self._low_m, pressing_m), max(self._high_m, pressing_m)
        travel_m = self._high_m - self._low_m
        if travel_m <= MOVED_M:
            return None
        return FilmFault.FROZEN.at(taken_ns, mn=force_n * 1e3, travel_mm=travel_m * 1e3)
