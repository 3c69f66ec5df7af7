"""R waves of an electrocardiogram (ECG), which announce the beats of the pulse. Pure and causal.

A wavelet of 60 ms responds most at 20 Hz, where a QRS complex has most of its power. It removes
constants, drift and mains hum, and reduces P and T waves. Peaks of its response above a threshold
are R waves. Threshold and sign follow the last beats, so gain and polarity of the lead do not
matter.

References
----------
Pan and Tompkins (1985), A real-time QRS detection algorithm, for threshold and refractory time.
"""

import math
import statistics
from typing import NamedTuple

from display_node.prediction.grid import MAX_GAP_NS, STEP_NS

# The wavelet is the mean of 20 ms minus the means of the 20 ms before and after it. A mean over
# 20 ms has a zero at 50 Hz, and the wavelet passes a tenth of 60 Hz.
WIDTH = 4
LENGTH = 3 * WIDTH
# Cells after which the running sum begins anew, before rounding matters.
SUMMED = 400
# A peak is an R wave once the response has fallen to this share of it, or after 40 ms.
FALLEN, LONGEST = 0.7, 8
# Least distance of two R waves in steps: 250 ms. Both signs of a complex peak within 100 ms.
REFRACTORY, COMPLEX = 50, 20
# Number of the last R waves that count, and the least number of them.
BEATS, FEWEST = 5, 2
# The threshold over the median peak. After PATIENCE median intervals without an R wave it falls to
# a half in 0.5 s, but not below a multiple of the mean response.
SHARE, PATIENCE, FALL, LOWEST = 0.45, 1.5, 0.5 ** (1 / 100), 3.0
# The other sign is used when its peaks are this much higher.
HIGHER = 1.25
# Memory of the mean response: 4 s. Peaks of noise are 3 to 4 times as high, those of an ECG more.
MEAN_STEPS = 800
DISTINCT = 4.5


class RWaveTime(NamedTuple):
    """Time of an R wave, and of the end of the samples by which it was found, in ns."""

    at_ns: int
    found_ns: int


class RWaveDetector:
    """Detector of R waves in the samples of one channel, at any rate and in any unit.

    distinct: whether the last peaks stand out from the signal, as those of an ECG do.
    """

    def __init__(self) -> None:
        self._newest_ns, self._newest = -(1 << 64), 0.0
        self._begin(0)
        self._step = 0
        self._sign, self._level = 0.0, 0.0
        self._mean = self._highest = self._height = 0.0
        self._last = self._opened = -REFRACTORY
        # Time and height of the last peaks, and for each sign its highest value in each complex.
        self._peaks: list[float] = []
        self._intervals: list[int] = []
        self._patience = math.inf
        self._sides: list[tuple[float, float]] = []
        self._top_step = 0
        self.distinct = False

    def _begin(self, t_ns: int) -> None:
        """Begin the wavelet's inputs after a gap; gain and sign are those before it."""
        # End of the present cell of 5 ms, and the integral of the signal in it until now.
        self._end_ns, self._area = t_ns + STEP_NS, 0.0
        self._sums = [0.0]
        # The highest response of the present peak with those before and after it.
        self._top: list[float] = []

    def observe(self, times_ns: list[int], values: list[float]) -> list[RWaveTime]:
        """Take new samples; return the R waves that have become certain.

        What comes late, after newer samples, is too late for an announcement.
        """
        found = []
        last_ns, last = self._newest_ns, self._newest
        for t_ns, value in zip(times_ns, values, strict=True):
            if t_ns <= last_ns:
                continue
            if t_ns - last_ns > MAX_GAP_NS or not math.isfinite(value - last):
                self._begin(t_ns)
            else:
                # The curve through the samples is linear between them.
                slope = (value - last) / (t_ns - last_ns)
                while self._end_ns <= t_ns:
                    end = last + slope * (self._end_ns - last_ns)
                    area = self._area + 0.5 * (self._end_ns - last_ns) * (last + end)
                    steps_ago = self._push(area / STEP_NS)
                    if steps_ago is not None:
                        at_ns = self._end_ns - round(steps_ago * STEP_NS)
                        found.append(RWaveTime(at_ns, self._end_ns))
                    last_ns, last, self._area = self._end_ns, end, 0.0
                    self._end_ns += STEP_NS
                self._area += 0.5 * (t_ns - last_ns) * (last + value)
            last_ns, last = t_ns, value
        self._newest_ns, self._newest = last_ns, last
        return found

    def _push(self, value: float) -> float | None:
        """Take the next cell; return how many steps before its end an R wave was, if certain."""
        sums = self._sums
        sums.append(sums[-1] + value)
        if len(sums) <= LENGTH:
            return None
        start, rise, fall, end = sums[-1 - LENGTH :: WIDTH]
        if len(sums) > SUMMED:
            self._sums = [each - start for each in sums[-1 - LENGTH :]]
        response = (3 * (fall - rise) - (end - start)) / (2 * WIDTH)
        self._step += 1
        self._mean += (abs(response) - self._mean) / min(self._step, MEAN_STEPS)
        self._highest = max(self._highest * FALL, abs(response))
        self._measure_sides(response)
        return self._search(self._sign * response if self._sign else abs(response))

    def _search(self, height: float) -> float | None:
        before, self._height = self._height, height
        if not self._top:
            if height > self._adapt() and self._step - self._last > REFRACTORY:
                self._top, self._top_step = [before, height], self._step
                self._opened = self._step
                self._sides = [*self._sides[1 - BEATS :], (0.0, 0.0)]
            return None
        if height > self._top[1]:
            self._top, self._top_step = [before, height], self._step
            return None
        if self._top_step == self._step - 1:
            self._top.append(height)
        waited = self._step - self._top_step
        if height > FALLEN * self._top[1] and waited < LONGEST:
            return None
        left, top, right = self._top
        self._take(top)
        # Vertex of the parabola through the highest response and its neighbours.
        vertex = 0.5 * (left - right) / (left - 2 * top + right) if left < top > right else 0.0
        return waited - vertex + LENGTH / 2

    def _adapt(self) -> float:
        """Return the threshold."""
        if not self._level:
            return SHARE * self._highest if self._step > LENGTH else math.inf
        threshold = SHARE * self._level
        late = self._step - self._last - self._patience
        if late > 0:
            threshold *= FALL**late
        return max(threshold, LOWEST * self._mean)

    def _take(self, height: float) -> None:
        if self._level and height < SHARE * self._level:
            # The lead's gain has fallen.
            self._peaks.clear()
        self._peaks = [*self._peaks[1 - BEATS :], height]
        if self._last > 0:
            self._intervals = [*self._intervals[1 - BEATS :], self._top_step - self._last]
            self._patience = PATIENCE * statistics.median(self._intervals)
        self._last, self._top = self._top_step, []
        if len(self._sides) >= FEWEST:
            self._level = statistics.median(self._peaks)
        self.distinct = self._level > DISTINCT * self._mean

    def _measure_sides(self, response: float) -> None:
        """Follow the peaks of both signs in the present complex; at its end, choose the sign."""
        if not self._sides or self._step - self._opened > COMPLEX:
            return
        above, below = self._sides[-1]
        self._sides[-1] = max(above, response), max(below, -response)
        if self._step - self._opened == COMPLEX and len(self._sides) >= FEWEST:
            above, below = map(statistics.median, zip(*self._sides, strict=True))
            bias = HIGHER**self._sign
            sign = 1.0 if above * bias >= below else -1.0
            if sign != self._sign:
                self._sign, self._level = sign, max(above, below)
                self._peaks = [self._level]
