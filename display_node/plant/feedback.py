"""A real feedback film: samples come when they come, a loop needs one a tick.

A sensor's samples arrive in batches, each some milliseconds after it was taken. Read at a
fixed age, they are as regular as the sensor took them, and the loop knows by how much they lag.

What the film under the finger says of the bench: too much soon, or what cannot be true.

A film that reads zero lets the loop press up to the force limit. The contact law of the softest
finger that a person has gives the least force that a position presses with; below it the film is
wrong. Far off the finger it reads nothing. Pure: times come in, in ns on the monotonic clock.
"""

import math
from collections import deque

from display_node.plant.stepper import StepperScene
from protocol.tactile import ElasticLayer

# The softest finger, as a share of the scene's `fingertip`. Fingertips are 0.5 to 5 N/mm.
SOFTEST = 0.25
# A finger may lie so much lower than the scene's `touch` says, or follow the tip so far.
PLACE_M = 0.5e-3
# Noise, and the film's own zero.
MARGIN_N = 0.05
# Positions and readings are of different ages, up to this; a contradiction lasts as long.
WITHIN_NS = 50_000_000


# A film whose reading does not change at all while the pressing tip goes so far is frozen.
MOVED_M = 0.15e-3
# A slope is taken over so long.
SLOPE_NS = 8_000_000
# From a reading to the motor's turn, beside the film's own latency.
REACTION_S = 10e-3


class RisingForce:
    """Foresees a felt force above the fault's bound, while there is time to turn.

    The loop's own commands rise no faster than the slew limit, and stop at the force limit. What
    rises faster is a drive that goes further than it was told.
    """

    def __init__(self, overforce_n: float, slew_limit_n_per_s: float, latency_ns: int) -> None:
        self._overforce_n = overforce_n
        self._slew_limit_n_per_s = slew_limit_n_per_s
        self._ahead_s = REACTION_S + latency_ns * 1e-9
        self._samples: deque[tuple[int, float]] = deque()

    def fault(self, force_n: float, taken_ns: int) -> str | None:
        """Take a reading in N; return the fault that it foresees."""
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
        return f"felt force rises by {slope:.0f} N/s at {force_n:.2f} N, faster than commanded"


class FilmPlausibility:
    """Compares the film's readings with the positions of the last 50 ms."""

    def __init__(self, actuator: StepperScene, layer: ElasticLayer) -> None:
        softest = actuator.model_copy(
            update={"fingertip_n_per_m": SOFTEST * actuator.fingertip_n_per_m}
        )
        self._law = softest.contact(layer)
        self._positions: deque[tuple[int, float]] = deque()
        self._plausible_ns = 0
        # The last reading, and the places of the pressing tip while it has been the same.
        self._same_n = math.nan
        self._low_m = self._high_m = 0.0

    def report(self, position_m: float, heard_ns: int) -> None:
        """Take a position in m from first touch."""
        positions = self._positions
        if not positions or heard_ns > positions[-1][0]:
            positions.append((heard_ns, position_m))
        while heard_ns - positions[0][0] > WITHIN_NS:
            positions.popleft()

    def contradiction(self, force_n: float, taken_ns: int) -> str | None:
        """Return what contradicts the positions in a reading, once it has done so for 50 ms."""
        places = [position_m for _, position_m in self._positions]
        fault = None
        if places:
            fault = self._named(force_n, min(places), max(places)) or self._frozen(
                force_n, max(places[-1], PLACE_M)
            )
        if fault is None or not self._plausible_ns:
            self._plausible_ns = taken_ns
        return fault if taken_ns - self._plausible_ns > WITHIN_NS else None

    def _named(self, force_n: float, lowest_m: float, highest_m: float) -> str | None:
        reads = f"the film reads {force_n * 1e3:.0f} mN"
        if lowest_m > self._law.position(max(force_n, 0.0) + MARGIN_N) + PLACE_M:
            least_mn = self._law.force(lowest_m - PLACE_M) * 1e3
            return f"{reads} where the tip presses with {least_mn:.0f} mN at least"
        if highest_m < -2 * PLACE_M and force_n > 2 * MARGIN_N:
            return f"{reads} where the tip is {-highest_m * 1e3:.1f} mm off the finger"
        return None

    def _frozen(self, force_n: float, pressing_m: float) -> str | None:
        if force_n != self._same_n:
            self._same_n, self._low_m, self._high_m = force_n, pressing_m, pressing_m
        self._low_m, self._high_m = min(self._low_m, pressing_m), max(self._high_m, pressing_m)
        went_m = self._high_m - self._low_m
        if went_m <= MOVED_M:
            return None
        reads = f"the film reads {force_n * 1e3:.0f} mN"
        return f"{reads} all along {went_m * 1e3:.2f} mm of the tip's way"


# Enough for an age of 50 ms at 10 kHz.
KEEP = 1_000
# The loop is stable with readings of the age that it assumes: with a film 20 ms late it swung, and
# pressed a finger three times as stiff as the scene's with 3.55 N of 2.5 N. Adapters deliver every
# 16 ms, so some readings of each 100 ms are new.
LATE_NS = 5_000_000
LATE_FOR_NS = 100_000_000
LATE_READS = 20


class Feedback:
    """Gives the film's force at a fixed age. Pure: samples and the time come in.

    latency_ns: the age; stale_after_ns: from the newest sample on, this long it stands in for
    those that do not come.
    """

    def __init__(self, latency_ns: int, stale_after_ns: int) -> None:
        self._latency_ns = latency_ns
        self._stale_after_ns = stale_after_ns
        self._samples: deque[tuple[int, float]] = deque(maxlen=KEEP)
        # Since when and for how long all readings have been late, how many, and their least age.
        self._late_since_ns = self._late_for_ns = self._late_reads = self._least_age_ns = 0
        self.samples = 0
        self.out_of_order = 0

    def hear(self, time_ns: int, force_n: float) -> None:
        """A sample that was taken at a time; one that is not newer than the last is counted
        and left out."""
        if self._samples and time_ns <= self._samples[-1][0]:
            self.out_of_order += 1
            return
        self.samples += 1
        self._samples.append((time_ns, force_n))

    @property
    def newest(self) -> tuple[int, float] | None:
        """Time and force in N of the newest sample; None before any."""
        return self._samples[-1] if self._samples else None

    def alive(self, now_ns: int) -> bool:
        """Return whether the newest sample is recent enough for readings."""
        samples = self._samples
        return bool(samples) and now_ns - samples[-1][0] <= self._stale_after_ns

    @property
    def late(self) -> str | None:
        """The fault of readings that have been older than assumed for 100 ms; None without."""
        if self._late_reads < LATE_READS or self._late_for_ns < LATE_FOR_NS:
            return None
        least_ms, assumed_ms = self._least_age_ns * 1e-6, self._latency_ns * 1e-6
        return (
            f"feedback late: readings are {least_ms:.0f} ms old or older, not {assumed_ms:.0f} ms"
        )

    def read(self, now_ns: int) -> float:
        """The force in N, `latency_ns` ago: between two samples on the straight line, after the
        newest that one. NaN where there is nothing to go by. Times must not go back."""
        samples, then_ns = self._samples, now_ns - self._latency_ns
        if not self.alive(now_ns):
            return math.nan
        self._judge(now_ns - samples[-1][0], now_ns)
        while len(samples) > 1 and samples[1][0] <= then_ns:
            samples.popleft()
        time_ns, force_n = samples[0]
        if then_ns <= time_ns or len(samples) == 1:
            return force_n
        next_ns, next_n = samples[1]
        return force_n + (next_n - force_n) * (then_ns - time_ns) / (next_ns - time_ns)

    def _judge(self, age_ns: int, now_ns: int) -> None:
        """Count readings that are all older than assumed; age_ns: of the newest one."""
        if age_ns <= self._latency_ns + LATE_NS:
            self._late_reads = 0
            return
        if not self._late_reads:
            self._late_since_ns, self._least_age_ns = now_ns, age_ns
        self._late_reads += 1
        self._late_for_ns = now_ns - self._late_since_ns
        self._least_age_ns = min(self._least_age_ns, age_ns)
