"""A synthetic heart: when each beat begins, how strong it is, and its electrocardiogram (ECG).

The rhythm is common to everything that the heart drives; the pulse at one place is drawn elsewhere
(`synthetic.py`). The R waves of the ECG announce the beats of that pulse.

References
----------
McSharry, Clifford, Tarassenko and Smith (2003), A dynamical model for generating synthetic
electrocardiogram signals, IEEE Transactions on Biomedical Engineering 50(3): the angles θ, widths b
and strengths a of five events. An event's amplitude is a b² over that of the R wave; at 60 beats a
minute its time is θ / 2π s from the R wave.
"""

import math
from collections import deque
from collections.abc import Iterable
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from protocol.config.quantities import Nanoseconds, Volts
from protocol.config.scene import Section
from protocol.wire.description import ANNOUNCE, Channel

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


MILLIVOLTS = 1e3
R_WAVE_MV = 1.0


class EcgWave(NamedTuple):
    """One Gaussian of an ECG: amplitude over the R wave's, time from it and width in s.

    stretches: whether the times follow the beat's length, as those of P and T waves do.
    """

    amplitude: float
    after_s: float
    width_s: float
    stretches: bool


WAVES = (
    EcgWave(0.25, -1 / 6, 0.0398, True),
    EcgWave(-0.17, -1 / 24, 0.0159, False),
    EcgWave(1.0, 0.0, 0.0159, False),
    EcgWave(-0.25, 1 / 24, 0.0159, False),
    EcgWave(0.4, 1 / 4, 0.0637, True),
)
# Times before and after an R wave at which its beat is drawn; the rest is below 1e-4 of it.
BEFORE_S, AFTER_S = 0.35, 0.55
# Greatest jitter over its standard deviation.
MOST = 4.0


class AnnounceScene(Section):
    """The `announce` table of a synthetic source: an ECG in the channel "announce".

    transit: from the R wave to the pulse's onset at distance 0. transit_jitter: its standard
    deviation. noise: RMS.
    """

    transit_ns: Annotated[Nanoseconds, Field(ge=0, le=500_000_000)] = 180_000_000
    transit_jitter_ns: Annotated[Nanoseconds, Field(ge=0, le=50_000_000)] = 0
    noise_v: Annotated[Volts, Field(ge=0, le=0.01)] = 10e-6


def draw_ecg(
    t_s: NDArray[np.floating[Any]], beats: Iterable[tuple[float, float]]
) -> NDArray[np.float64]:
    """Return the ECG in mV at ascending times, from each beat's R wave and stretch."""
    ecg_mv = np.zeros(len(t_s))
    for at_s, stretch in beats:
        first, last = np.searchsorted(t_s, (at_s - BEFORE_S, at_s + AFTER_S))
        since_s = t_s[first:last] - at_s
        for wave in WAVES:
            scale = stretch if wave.stretches else 1.0
            z = (since_s - scale * wave.after_s) / (scale * wave.width_s)
            ecg_mv[first:last] += R_WAVE_MV * wave.amplitude * np.exp(-0.5 * z * z)
    return ecg_mv


class EcgColumn:
    """The channel "announce": an ECG whose R waves come by the transit time before the onsets."""

    def __init__(self, scene: AnnounceScene, period_s: float, rng: np.random.Generator) -> None:
        self.channel = Channel(ANNOUNCE, "mV")
        self._scene, self._period_s, self._rng = scene, period_s, rng
        self._beats: deque[tuple[float, float]] = deque(maxlen=16)
        self._drawn = 0

    def draw(self, beat: Heartbeat) -> NDArray[np.float64]:
        """Draw one beat, and return the samples in mV that no later beat can change."""
        scene = self._scene
        transit_s, deviation_s = scene.transit_ns * 1e-9, scene.transit_jitter_ns * 1e-9
        jitter = max(-MOST, min(MOST, float(self._rng.standard_normal())))
        self._beats.append((beat.onset_s - transit_s - deviation_s * jitter, beat.stretch))
        end_s = beat.next_onset_s - transit_s - MOST * deviation_s - BEFORE_S
        first = self._drawn
        self._drawn = max(first, int(end_s / self._period_s))
        t_s = np.arange(first, self._drawn) * self._period_s
        noise_mv = MILLIVOLTS * scene.noise_v * self._rng.standard_normal(len(t_s))
        return draw_ecg(t_s, self._beats) + noise_mv
