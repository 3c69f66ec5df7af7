"""Height of the pulse and its respiratory wave, beat by beat, for the model of the tissue. Pure."""

import math
from collections import deque

import numpy as np

# A height is measured in a beat in which the hold-down stays within this share and force.
STEADY_SHARE, STEADY_N = 0.04, 0.01
# Respiration: its typical rate and the bounds of it, its deviation over the pulse pressure and the
# time for which it stays regular, and the part of an error by which a peak corrects the rate.
RESPIRATION_RAD_PER_S, SLOWEST_RAD_PER_S, FASTEST_RAD_PER_S = 1.7, 1.0, 2.4
WAVE, WAVE_S, MOST_WAVE, RATE_PART = 0.06, 20.0, 0.1, 0.1
# Deviation of the peaks' mean from a typical one, its change from beat to beat, and their error.
MEAN, MEAN_CHANGE, PEAK_ERROR = 0.02, 0.001, 0.04
# A peak is above PEAK of the pulse pressure, and the highest value for PEAK_NS.
PEAK, TROUGH, PEAK_NS = 0.7, 0.4, 150_000_000


class PulseHeight:
    """Foot and height of each beat at a steady hold-down: a peak, and the lowest value before it.

    A peak is the highest value within half a beat before and after it. The foot belongs to the same
    upstroke, so a respiratory wave changes both alike.
    """

    def __init__(self) -> None:
        self._means: deque[tuple[int, float, float]] = deque()

    def add(
        self, hold_down_n: float, pulse_n: float, now_ns: int, beat_ns: int
    ) -> tuple[float, float, float, float] | None:
        """Take a frame's means; return hold-down, foot, height and motion of a complete beat.

        The motion is the largest distance of the hold-down from its mean over the beat.
        """
        means = self._means
        if means and now_ns - means[-1][0] > beat_ns // 8:
            means.clear()
        means.append((now_ns, hold_down_n, pulse_n))
        while now_ns - means[0][0] > beat_ns:
            means.popleft()
        if now_ns - means[0][0] < beat_ns - beat_ns // 16:
            return None
        at = len(means) // 2
        pulses_n = [each[2] for each in means]
        high_n = pulses_n[at]
        if high_n <= max(*pulses_n[:at], *pulses_n[at + 1 :]):
            return None
        mean_n = sum(each[1] for each in means) / len(means)
        moved_n = max(abs(each[1] - mean_n) for each in means)
        if moved_n > STEADY_SHARE * abs(mean_n) + STEADY_N:
            return None
        low_n = min(pulses_n[:at])
        return mean_n, low_n, high_n - low_n, moved_n


class RespiratoryWave:
    """Respiration in the artery's pressure, followed from peak to peak.

    A closed artery shows no diastole. Its pressure then follows from the peaks before, as
    respiration moves both alike. The peaks' mean is left out, as it shows errors of the law.

    now: what respiration adds to the pressure, relative to the pulse pressure.
    """

    def __init__(self) -> None:
        # Wave, the same a quarter of a period before, and the mean.
        self._state = np.zeros(3)
        self._covariance = np.diag([WAVE**2, WAVE**2, MEAN**2])
        self._rad_per_s = RESPIRATION_RAD_PER_S
        self._at_ns: int | None = None
        self._high: float | None = None
        self._high_ns = 0
        self.now = 0.0

    def observe(self, pressure: float, now_ns: int) -> None:
        """Take the relative pressure at a time."""
        if pressure < TROUGH:
            self._high = 0.0
        if self._high is not None and pressure > self._high:
            self._high, self._high_ns = pressure, now_ns
        elif self._high is not None and self._high > PEAK and now_ns - self._high_ns >= PEAK_NS:
            self._take(self._high - 1.0, self._high_ns)
            self._high = None
        angle = self._rad_per_s * self._elapsed_s(now_ns)
        wave, quarter, _ = self._state.tolist()
        now = wave * math.cos(angle) - quarter * math.sin(angle)
        self.now = min(max(now, -MOST_WAVE), MOST_WAVE)

    def _elapsed_s(self, at_ns: int) -> float:
        return 0.0 if self._at_ns is None else (at_ns - self._at_ns) * 1e-9

    def _take(self, peak: float, at_ns: int) -> None:
        """Take a beat's peak, relative to a typical one: a step of a Kalman filter."""
        elapsed_s = self._elapsed_s(at_ns)
        self._at_ns = at_ns
        kept, angle = math.exp(-abs(elapsed_s) / WAVE_S), self._rad_per_s * elapsed_s
        cos, sin = kept * math.cos(angle), kept * math.sin(angle)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        fresh = (1 - kept**2) * WAVE**2
        self._covariance = turn @ self._covariance @ turn.T
        self._covariance += np.diag([fresh, fresh, MEAN_CHANGE**2])
        self._state = turn @ self._state
        seen = np.array([1.0, 0.0, 1.0])
        gains = self._covariance @ seen
        variance = float(seen @ gains) + PEAK_ERROR**2
        error = min(max(peak - float(seen @ self._state), -MOST_WAVE), MOST_WAVE)
        wave, quarter, _ = self._state.tolist()
        size = wave**2 + quarter**2 + WAVE**2 / 4
        self._rad_per_s -= RATE_PART * error * quarter / size
        self._rad_per_s = min(max(self._rad_per_s, SLOWEST_RAD_PER_S), FASTEST_RAD_PER_S)
        self._state += gains * (error / variance)
        self._covariance -= np.outer(gains, gains) / variance
