"""The finger's press from its sensor: pulse subtracted, averaged over a beat. Pure.

What is left of the pulse in the press would travel to the wrist and come back as a pulse: it is the
only way round the network. So its share is learnt and subtracted, and the rest is averaged over a
beat, in which a pulse without its mean adds up to nothing. A motion of the finger restarts the
average, so that a step of the press is followed at once.
"""

import math
from collections import deque
from typing import Final

# Corner of the high-pass by which pulse and reading are compared, and time constants of readings:
# of what moves the tip, and of what scales the pulse, which is felt wrong where it lags a step.
COMPARE_FROM_HZ: Final = 1.0
FOLLOW_S, SCALE_S = 15e-3, 5e-3
# Time over which the pulse's share in the reading is learnt.
LEARN_S: Final = 5.0
MOST_SHARE: Final = 4.0
# Time over which it is measured what the subtraction leaves: two to three beats.
REMAINING_S: Final = 2.0
# Until so much of the still reading is known, any reading within MOST_SHARE pulses may be the
# pulse. A moving finger forgets six times as slowly.
KNOWN_S: Final = 1.0
FORGET_MOVING_S: Final = 6 * LEARN_S
PEAK_S: Final = 2.0
# The finger moves where reading and average differ by so much for MOVES_AFTER_NS: the largest of a
# share of the press, a force, and a multiple of what the pulse leaves.
MOVES_SHARE, MOVES_N, MOVES_DEVIATIONS = 0.01, 0.01, 4.0
MOVES_AFTER_NS: Final = 6_000_000
# A residue beyond this share of the press is motion, not noise.
MOST_RESIDUE: Final = 0.1
# Nothing is learnt of the pulse for this time after a motion.
STILL_NS: Final = 400_000_000
DEFAULT_BEAT_NS: Final = 800_000_000


class PulseShare:
    """Share of the rendered pulse in the press sensor's reading, learnt by regression.

    share: the estimate. remaining: share that was left after its subtraction, over some beats.
    """

    def __init__(self) -> None:
        self._reading_n = self._pulse_n = 0.0
        self._products = self._squares = self._rest = self._weight = 0.0
        self._peak_n = 0.0
        self._left = self._left_squares = 0.0
        self.share = 1.0

    @property
    def residue_n(self) -> float:
        """RMS of the reading that the pulse's share does not explain."""
        return math.sqrt(self._rest / self._weight) if self._weight else 0.0

    @property
    def remaining(self) -> float:
        """Share of the pulse that was left after its subtraction, over the last seconds."""
        left, squares = abs(self._left), self._left_squares
        return left / squares if left < MOST_SHARE * squares else MOST_SHARE

    @property
    def known(self) -> bool:
        """True once the share is known."""
        return self._weight >= KNOWN_S

    @property
    def unknown_n(self) -> float:
        """Largest part of the reading that may be the pulse, because its share is not known yet."""
        return 0.0 if self.known else MOST_SHARE * self._peak_n

    def skip(self, reading_n: float, pulse_n: float, elapsed_s: float) -> None:
        """Take a reading of a moving finger, from which nothing is learnt."""
        self._reading_n, self._pulse_n = reading_n, pulse_n
        self._peak_n = max(abs(pulse_n), self._peak_n * math.exp(-elapsed_s / PEAK_S))
        kept = math.exp(-elapsed_s / FORGET_MOVING_S)
        self._products, self._squares = kept * self._products, kept * self._squares
        self._rest, self._weight = kept * self._rest, kept * self._weight

    def add(self, reading_n: float, pulse_n: float, elapsed_s: float) -> None:
        """Take a reading and the pulse that was rendered at its time."""
        self._peak_n = max(abs(pulse_n), self._peak_n * math.exp(-elapsed_s / PEAK_S))
        part = -math.expm1(-2 * math.pi * COMPARE_FROM_HZ * elapsed_s)
        self._reading_n += (reading_n - self._reading_n) * part
        self._pulse_n += (pulse_n - self._pulse_n) * part
        reading_n, pulse_n = reading_n - self._reading_n, pulse_n - self._pulse_n
        kept = math.exp(-elapsed_s / LEARN_S)
        self._products = kept * self._products + reading_n * pulse_n * elapsed_s
        self._squares = kept * self._squares + pulse_n * pulse_n * elapsed_s
        self._weight = kept * self._weight + elapsed_s
        rest_n = reading_n - self.share * pulse_n
        soon = math.exp(-elapsed_s / REMAINING_S)
        self._left = soon * self._left + rest_n * pulse_n * elapsed_s
        self._left_squares = soon * self._left_squares + pulse_n * pulse_n * elapsed_s
        self._rest = kept * self._rest + rest_n * rest_n * elapsed_s
        if self._squares > 0:
            self.share = min(max(self._products / self._squares, 0.0), MOST_SHARE)


class PressReading:
    """Estimate of the finger's static press.

    Attributes
    ----------
    press_n
        The estimate in N, never negative.
    beat_ns
        Time of a beat, over which readings are averaged; set it to the pulse's.
    follow_n
        Estimate without the average, for what has to follow the finger at once.
    scale_n
        A faster one, which does not move the tip.
    mean_pulse_n
        Mean of the rendered pulse over the readings that were averaged.
    """

    def __init__(self) -> None:
        self._pulse = PulseShare()
        self._window: deque[tuple[int, float, float]] = deque()
        self._sum_n = self._pulse_sum_n = 0.0
        self.follow_n = self.scale_n = 0.0
        self._begun = False
        self._last_ns = self._moved_ns = 0
        self._differs_ns: int | None = None
        self.beat_ns = DEFAULT_BEAT_NS
        self.press_n = self.mean_pulse_n = 0.0

    @property
    def pulse_share(self) -> float:
        """Learnt share of the rendered pulse in the reading."""
        return self._pulse.share

    @property
    def remaining(self) -> float:
        """Share of the rendered pulse that was left after its subtraction."""
        return self._pulse.remaining

    @property
    def still(self) -> bool:
        """True while the finger has not moved lately."""
        return self._last_ns - self._moved_ns > STILL_NS

    @property
    def now_n(self) -> float:
        """Estimate for what follows the finger at once, without an average once it may be."""
        return max(0.0, self.follow_n) if self._pulse.known else self.press_n

    @property
    def scaling_n(self) -> float:
        """Estimate by which the pulse is scaled, without an average once it may be."""
        return max(0.0, self.scale_n) if self._pulse.known else self.press_n

    def add(self, reading_n: float, pulse_n: float, now_ns: int) -> float:
        """Take a finite reading in N, and the pulse rendered at its time; return the press."""
        if not self._begun:
            self._begun = True
            self.follow_n = self.scale_n = reading_n
            self._last_ns = self._moved_ns = now_ns
        elapsed_s, self._last_ns = max(0, now_ns - self._last_ns) * 1e-9, now_ns
        rest_n = reading_n - self._pulse.share * pulse_n
        self.follow_n += (rest_n - self.follow_n) * -math.expm1(-elapsed_s / FOLLOW_S)
        self.scale_n += (rest_n - self.scale_n) * -math.expm1(-elapsed_s / SCALE_S)
        if self._moves(self.follow_n, now_ns):
            self._window.clear()
            self._moved_ns = now_ns
        if self.still:
            self._pulse.add(reading_n, pulse_n, elapsed_s)
        else:
            self._pulse.skip(reading_n, pulse_n, elapsed_s)
        self._average(rest_n, pulse_n, now_ns)
        return self.press_n

    def _moves(self, follow_n: float, now_ns: int) -> bool:
        """Return whether the finger has left the average."""
        pulse = self._pulse
        residue_n = min(pulse.residue_n, MOST_RESIDUE * self.press_n)
        most_n = max(
            MOVES_SHARE * self.press_n, MOVES_N, MOVES_DEVIATIONS * residue_n, pulse.unknown_n
        )
        if abs(follow_n - self.press_n) <= most_n:
            self._differs_ns = None
            return False
        if self._differs_ns is None:
            self._differs_ns = now_ns
        return now_ns - self._differs_ns >= MOVES_AFTER_NS

    def _average(self, rest_n: float, pulse_n: float, now_ns: int) -> None:
        window = self._window
        window.append((now_ns, rest_n, pulse_n))
        self._sum_n += rest_n
        self._pulse_sum_n += pulse_n
        while now_ns - window[0][0] >= self.beat_ns:
            _, old_n, old_pulse_n = window.popleft()
            self._sum_n -= old_n
            self._pulse_sum_n -= old_pulse_n
        if len(window) == 1:
            # Begins anew, without the rounding of the sums before.
            self._sum_n, self._pulse_sum_n = rest_n, pulse_n
        self.press_n = max(0.0, self._sum_n / len(window))
        self.mean_pulse_n = self._pulse_sum_n / len(window)
