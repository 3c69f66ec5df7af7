"""A synthetic pulse: a sum of Gaussians over each beat.

A beat has a percussion, a tidal and a dicrotic wave. Heart-rate variability, respiration, ectopic
beats, noise and mains hum are options. The same seed gives the same samples, in blocks of any size.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from protocol.config.quantities import Hertz, Newtons, Ratio
from protocol.config.scene import Section
from protocol.wire.stream import Channel


@dataclass(frozen=True, slots=True)
class Wave:
    """One Gaussian of a beat; times in s, for a beat interval of 0.8 s."""

    amplitude: float
    centre_s: float
    width_s: float


NOMINAL_BEAT_S = 0.8
PRESETS: dict[str, tuple[Wave, ...]] = {
    # Reproduces the energy shares of the Welch spectrum of Dargahi et al. (2008) at 75 beats/min.
    "paper": (Wave(1.0, 0.12, 0.0162), Wave(0.689, 0.2361, 0.0325), Wave(0.3384, 0.394, 0.0356)),
    "wide": (Wave(1.0, 0.14, 0.045), Wave(0.5, 0.28, 0.055), Wave(0.3, 0.45, 0.06)),
}
# A wave is drawn this many widths to either side; beyond, it is below 1e-9 of its amplitude.
REACH = 6.5
SLOW_RHYTHM_HZ = 0.1
# Share of the two slow rhythms in the beat interval's variance; the rest is random.
RHYTHMIC = 0.8
ECTOPIC_EARLY, ECTOPIC_PAUSE, ECTOPIC_AMPLITUDE = 0.6, 1.4, 0.6


class SyntheticScene(Section):
    """The `source` table of kind "synthetic".

    heart_rate_variability: standard deviation of the beat interval over its mean. respiration: RMS
    of its wave over the beat's standard deviation. ectopic: share of premature beats. hum:
    amplitude of the mains hum, a sine of hum_rate.
    """

    kind: Literal["synthetic"]
    preset: Literal["paper", "wide"] = "wide"
    rate_hz: Annotated[Hertz, Field(ge=10, le=100_000)] = 1000.0
    heart_rate_hz: Annotated[Hertz, Field(ge=0.3, le=4)] = 1.25
    peak_to_peak_n: Annotated[Newtons, Field(gt=0, le=10)] = 0.3
    preload_n: Annotated[Newtons, Field(ge=0, le=10)] = 0.3
    heart_rate_variability: Annotated[Ratio, Field(ge=0, le=0.3)] = 0.0
    respiration: Annotated[Ratio, Field(ge=0, le=2)] = 0.0
    respiration_rate_hz: Annotated[Hertz, Field(ge=0.05, le=1)] = 0.25
    ectopic: Annotated[Ratio, Field(ge=0, le=0.5)] = 0.0
    noise_n: Annotated[Newtons, Field(ge=0, le=1)] = 0.0
    hum_n: Annotated[Newtons, Field(ge=0, le=1)] = 0.0
    hum_rate_hz: Annotated[Hertz, Field(ge=1, le=1000)] = 50.0
    seed: Annotated[int, Field(ge=0)] = 1


class SyntheticSource:
    """A synthetic pulse in N, with one channel."""

    channels = (Channel("pulse"),)

    def __init__(self, scene: SyntheticScene) -> None:
        self._scene = scene
        self._rng = np.random.default_rng(scene.seed)
        self._rhythm_phase_rad = self._rng.uniform(0, 2 * math.pi)
        self.period_ns = round(1e9 / scene.rate_hz)
        self._period_s = self.period_ns * 1e-9
        self._waves = PRESETS[scene.preset]
        # Mean and deviation of an endless series of nominal beats, and newtons per unit.
        beat_s = 1 / scene.heart_rate_hz
        t_s, stretch = np.arange(0, beat_s, 1e-4), math.sqrt(beat_s / NOMINAL_BEAT_S)
        beats = [_beat(self._waves, t_s - shift * beat_s, stretch) for shift in range(-3, 4)]
        row = np.sum(beats, axis=0)
        self._mean, self._deviation = float(row.mean()), float(row.std())
        self._scale_n = scene.peak_to_peak_n / float(np.ptp(row))
        widest = max(wave.width_s for wave in self._waves)
        # A beat's first wave may begin before the beat; earlier samples than this are final.
        lead_s = max(0.0, *(REACH * w.width_s - w.centre_s for w in self._waves))
        self._lead = math.ceil(1.5 * (lead_s + widest) / self._period_s)
        self._pending = np.zeros(0)
        self._pending_first = -self._lead
        self._beat_onset_s = -2 * self._interval_s(0.0)
        self._early = False
        # Samples of complete beats, and the number of those that were taken.
        self._ready = np.zeros((0, 1))
        self._taken = 0

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next `count` samples in N, shape (count, 1)."""
        first, self._taken = self._taken, self._taken + count
        while self._taken > len(self._ready):
            beat = self._next_beat()[:, np.newaxis]
            self._ready = np.concatenate([self._ready[first:], beat])
            first, self._taken = 0, self._taken - first
        return self._ready[first : self._taken]

    def _interval_s(self, onset_s: float) -> float:
        """Return the beat interval at a time: slow rhythm, respiratory rhythm and chance."""
        scene, variability = self._scene, self._scene.heart_rate_variability
        if variability == 0:
            return 1 / scene.heart_rate_hz
        phase = self._rhythm_phase_rad
        unit = (
            math.sin(2 * math.pi * SLOW_RHYTHM_HZ * onset_s + phase) * math.sqrt(RHYTHMIC)
            + math.sin(2 * math.pi * scene.respiration_rate_hz * onset_s) * math.sqrt(RHYTHMIC)
            + self._rng.standard_normal() * math.sqrt(1 - RHYTHMIC)
        )
        # More beats occur while the rhythms shorten them, so the mean interval is lengthened.
        mean_s = (1 + RHYTHMIC * variability**2) / scene.heart_rate_hz
        return mean_s * max(0.4, 1 + variability * unit)

    def _next_beat(self) -> NDArray[np.float64]:
        """Draw one beat and return the samples that no later beat can change."""
        scene, amplitude = self._scene, 1.0
        interval_s = self._interval_s(self._beat_onset_s)
        if self._early:
            amplitude, self._early = ECTOPIC_AMPLITUDE, False
            interval_s *= ECTOPIC_PAUSE
        elif scene.ectopic and self._rng.random() < scene.ectopic / (1 - scene.ectopic):
            # Only beats that are not premature are followed by one, hence the odds.
            self._early = True
            interval_s *= ECTOPIC_EARLY
        # Systole shortens less than the interval: its times scale with the square root.
        stretch = math.sqrt(min(interval_s, 1 / scene.heart_rate_hz) / NOMINAL_BEAT_S)
        onset = round(self._beat_onset_s / self._period_s)
        end_s = max(w.centre_s + REACH * w.width_s for w in self._waves) * stretch
        first, last = onset - self._lead, onset + math.ceil(end_s / self._period_s)
        self._extend(last)
        indices = np.arange(max(first, self._pending_first), last)
        shape = _beat(self._waves, indices * self._period_s - self._beat_onset_s, stretch)
        self._pending[indices - self._pending_first] += amplitude * shape
        self._beat_onset_s += interval_s
        return self._finish(round(self._beat_onset_s / self._period_s) - self._lead)

    def _extend(self, last: int) -> None:
        missing = last - self._pending_first - len(self._pending)
        if missing > 0:
            self._pending = np.concatenate([self._pending, np.zeros(missing)])

    def _finish(self, end: int) -> NDArray[np.float64]:
        """Return the pending samples up to index `end` in newtons."""
        self._extend(end)
        count = max(0, end - self._pending_first)
        shape, self._pending = self._pending[:count], self._pending[count:]
        indices = np.arange(self._pending_first, self._pending_first + count)
        self._pending_first += count
        scene = self._scene
        unit = shape - self._mean
        if scene.respiration:
            breath = np.sin(2 * math.pi * scene.respiration_rate_hz * indices * self._period_s)
            unit = unit + scene.respiration * self._deviation * math.sqrt(2) * breath
        force_n = scene.preload_n + self._scale_n * unit
        if scene.noise_n:
            force_n = force_n + scene.noise_n * self._rng.standard_normal(count)
        if scene.hum_n:
            hum = np.sin(2 * math.pi * scene.hum_rate_hz * indices * self._period_s)
            force_n = force_n + scene.hum_n * hum
        return force_n[indices >= 0]


def _beat(
    waves: tuple[Wave, ...], t_s: NDArray[np.floating[Any]], stretch: float
) -> NDArray[np.float64]:
    """Return one beat at times after its onset."""
    shape = np.zeros(len(t_s))
    for wave in waves:
        z = (t_s - wave.centre_s * stretch) / (wave.width_s * stretch)
        shape += wave.amplitude * np.exp(-0.5 * z * z)
    return shape
