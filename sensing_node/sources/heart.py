"""The rhythm of a synthetic heart: when each beat begins, and how strong it is.

A rhythm is common to everything that the heart drives; what a beat looks like at one place is drawn
elsewhere (`synthetic.py`).
"""

import math
from typing import NamedTuple

import numpy as np

NOMINAL_BEAT_S = 0.8
SLOW_RHYTHM_HZ = 0.1
# Share of the two slow rhythms in the beat interval's variance; the rest is random.
RHYTHMIC = 0.8
ECTOPIC_EARLY, ECTOPIC_PAUSE, ECTOPIC_AMPLITUDE = 0.6, 1.4, 0.6


class Heartbeat(NamedTuple):
    """One beat: its onset, the interval to the next, and its amplitude; 1 for a normal one.

    stretch: factor of the times of systole, whose nominal values are for a beat of 0.8 s.
    """

    onset_s: float
    interval_s: float
    amplitude: float
    stretch: float

    @property
    def next_onset_s(self) -> float:
        """Onset of the next beat."""
        return self.onset_s + self.interval_s


class SyntheticHeart:
    """Beats one after the other; the first begins two intervals before time 0.

    heart_rate_hz: mean rate. variability: standard deviation of the interval over its mean.
    respiration_rate_hz: of the respiratory rhythm. ectopic: share of premature beats.
    """

    def __init__(
        self,
        heart_rate_hz: float,
        variability: float,
        respiration_rate_hz: float,
        ectopic: float,
        rng: np.random.Generator,
    ) -> None:
        self._heart_rate_hz, self._variability = heart_rate_hz, variability
        self._respiration_rate_hz, self._ectopic = respiration_rate_hz, ectopic
        self._rng = rng
        self._phase_rad = rng.uniform(0, 2 * math.pi)
        self._onset_s = -2 * self._interval_s(0.0)
        self._early = False

    def next_beat(self) -> Heartbeat:
        """Return the next beat."""
        onset_s, amplitude = self._onset_s, 1.0
        interval_s = self._interval_s(onset_s)
        if self._early:
            amplitude, self._early = ECTOPIC_AMPLITUDE, False
            interval_s *= ECTOPIC_PAUSE
        elif self._ectopic and self._rng.random() < self._ectopic / (1 - self._ectopic):
            # Only beats that are not premature are followed by one, hence the odds.
            self._early = True
            interval_s *= ECTOPIC_EARLY
        # Systole shortens less than the interval: its times scale with the square root.
        stretch = math.sqrt(min(interval_s, 1 / self._heart_rate_hz) / NOMINAL_BEAT_S)
        beat = Heartbeat(onset_s, interval_s, amplitude, stretch)
        self._onset_s = beat.next_onset_s
        return beat

    def _interval_s(self, onset_s: float) -> float:
        """Return the beat interval at a time: slow rhythm, respiratory rhythm and chance."""
        if self._variability == 0:
            return 1 / self._heart_rate_hz
        unit = (
            math.sin(2 * math.pi * SLOW_RHYTHM_HZ * onset_s + self._phase_rad) * math.sqrt(RHYTHMIC)
            + math.sin(2 * math.pi * self._respiration_rate_hz * onset_s) * math.sqrt(RHYTHMIC)
            + self._rng.standard_normal() * math.sqrt(1 - RHYTHMIC)
        )
        # More beats occur while the rhythms shorten them, so the mean interval is lengthened.
        mean_s = (1 + RHYTHMIC * self._variability**2) / self._heart_rate_hz
        return mean_s * max(0.4, 1 + self._variability * unit)
