"""A synthetic pulse: a sum of Gaussians over each beat, at one place of the artery or several.

A beat has a percussion, a tidal and a dicrotic wave. Heart-rate variability, respiration, ectopic
beats, noise and mains hum are options. The same seed gives the same samples, in blocks of any size.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from protocol.config.quantities import Hertz, Metres, MetresPerSecond, Name, Newtons, Ratio
from protocol.config.scene import Section
from protocol.wire.description import ANNOUNCE, PULSE, Channel, first_repeated
from sensing_node.sources.heart import (
    NOMINAL_BEAT_S,
    AnnounceScene,
    EcgColumn,
    Heartbeat,
    SyntheticHeart,
)
from sensing_node.sources.source import SampleSource, SourceContext, SourceScene


@dataclass(frozen=True, slots=True)
class Wave:
    """One Gaussian of a beat; times in s, for a beat interval of 0.8 s."""

    amplitude: float
    centre_s: float
    width_s: float


PRESETS: dict[str, tuple[Wave, ...]] = {
    # Reproduces the energy shares of the Welch spectrum of Dargahi et al. (2008) at 75 beats/min.
    "paper": (Wave(1.0, 0.12, 0.0162), Wave(0.689, 0.2361, 0.0325), Wave(0.3384, 0.394, 0.0356)),
    "wide": (Wave(1.0, 0.14, 0.045), Wave(0.5, 0.28, 0.055), Wave(0.3, 0.45, 0.06)),
}
# A wave is drawn this many widths to either side; beyond, it is below 1e-9 of its amplitude.
REACH = 6.5
# Beats whose times are kept, for whoever compares them with what was found.
KEPT_BEATS = 100
Preset = Literal["paper", "wide"]
PeakToPeak = Annotated[Newtons, Field(gt=0, le=10)]
Preload = Annotated[Newtons, Field(ge=0, le=10)]


class PositionScene(Section):
    """A `position` table: one place of the artery, which becomes one channel.

    distance: along the artery, from the place at which the source's beats begin. preset,
    peak_to_peak, preload: the source's where they are not given.
    """

    name: Name
    distance_m: Annotated[Metres, Field(ge=0, le=0.3)] = 0.0
    preset: Preset | None = None
    peak_to_peak_n: PeakToPeak | None = None
    preload_n: Preload | None = None


class SyntheticScene(SourceScene):
    """The `source` table of kind "synthetic".

    heart_rate_variability: standard deviation of the beat interval over its mean. respiration: RMS
    of its wave over the beat's standard deviation. ectopic: share of premature beats. hum:
    amplitude of the mains hum, a sine of hum_rate. position: places of the artery, one channel
    each; without any there is one channel, "pulse". pulse_wave_velocity: from one place to another.
    announce: an ECG, as one more channel.
    """

    kind: Literal["synthetic"]
    preset: Preset = "wide"
    rate_hz: Annotated[Hertz, Field(ge=10, le=100_000)] = 1000.0
    heart_rate_hz: Annotated[Hertz, Field(ge=0.3, le=4)] = 1.25
    peak_to_peak_n: PeakToPeak = 0.3
    preload_n: Preload = 0.3
    heart_rate_variability: Annotated[Ratio, Field(ge=0, le=0.3)] = 0.0
    respiration: Annotated[Ratio, Field(ge=0, le=2)] = 0.0
    respiration_rate_hz: Annotated[Hertz, Field(ge=0.05, le=1)] = 0.25
    ectopic: Annotated[Ratio, Field(ge=0, le=0.5)] = 0.0
    noise_n: Annotated[Newtons, Field(ge=0, le=1)] = 0.0
    hum_n: Annotated[Newtons, Field(ge=0, le=1)] = 0.0
    hum_rate_hz: Annotated[Hertz, Field(ge=1, le=1000)] = 50.0
    seed: Annotated[int, Field(ge=0)] = 1
    pulse_wave_velocity_m_per_s: Annotated[MetresPerSecond, Field(ge=2, le=30)] = 8.0
    position: Annotated[tuple[PositionScene, ...], Field(max_length=16)] = ()
    announce: AnnounceScene | None = None

    @model_validator(mode="after")
    def _has_distinct_positions(self) -> Self:
        names = [position.name for position in self.position]
        twice = first_repeated(names)
        if twice is not None:
            raise ValueError(f"two positions have the name {twice!r}; each is a channel")
        if ANNOUNCE in names:
            raise ValueError(f"no position may have the name {ANNOUNCE!r}, which no force has")
        if "pulse_wave_velocity_m_per_s" in self.model_fields_set and not names:
            raise ValueError("pulse_wave_velocity needs [[sensing.source.position]] tables")
        return self

    def build(self, context: SourceContext) -> "SyntheticSource":
        """See `SourceScene.build`."""
        return SyntheticSource(self)

    def ideal(self) -> Self:
        """Return the table without mains hum."""
        return self.model_copy(update={"hum_n": 0.0})

    def with_seed(self, seed: int) -> Self:
        """Return the table with another seed."""
        return self.model_copy(update={"seed": seed})

    def still(self) -> Self:
        """Return the table without its pulse."""
        no_force = {"peak_to_peak_n": 0.0, "preload_n": 0.0}
        positions = tuple(each.model_copy(update=no_force) for each in self.position)
        return self.model_copy(update=no_force | {"position": positions})

    @property
    def places(self) -> tuple[PositionScene, ...]:
        """The positions; without any, the one of the channel "pulse"."""
        return self.position or (PositionScene(name=PULSE),)

    def at(self, position: PositionScene) -> "SyntheticScene":
        """Return the scene with what the position gives in place of the source's."""
        own = position.model_dump(include={"preset", "peak_to_peak_n", "preload_n"})
        update = {key: value for key, value in own.items() if value is not None}
        return self.model_copy(update=update)


class SyntheticSource(SampleSource):
    """A synthetic pulse in N, one channel for each position of one heart's artery.

    beats: the last 100 beats that were drawn; the pulse of one begins at each channel
    `delays_s` after its onset.
    """

    def __init__(self, scene: SyntheticScene) -> None:
        self.period_ns = round(1e9 / scene.rate_hz)
        period_s = self.period_ns * 1e-9
        rng = np.random.default_rng(scene.seed)
        self._heart = SyntheticHeart(
            scene.heart_rate_hz,
            scene.heart_rate_variability,
            scene.respiration_rate_hz,
            scene.ectopic,
            rng,
        )
        velocity_m_per_s = scene.pulse_wave_velocity_m_per_s
        self.delays_s = tuple(place.distance_m / velocity_m_per_s for place in scene.places)
        # The first one's noise is drawn with the rhythm; so further ones change neither.
        rngs = [rng, *(np.random.default_rng((scene.seed, n)) for n in range(1, len(scene.places)))]
        self._columns: list[PulseColumn | EcgColumn] = [
            PulseColumn(scene.at(place), place.name, delay_s, period_s, own_rng)
            for place, delay_s, own_rng in zip(scene.places, self.delays_s, rngs, strict=True)
        ]
        if scene.announce is not None:
            ecg_rng = np.random.default_rng((scene.seed, len(scene.places)))
            self._columns.append(EcgColumn(scene.announce, period_s, ecg_rng))
        self.channels = tuple(column.channel for column in self._columns)
        self.beats: deque[Heartbeat] = deque(maxlen=KEPT_BEATS)
        # Samples that are final in all channels, the number of those that were taken, and the
        # further final ones of each channel.
        self._ready = np.zeros((0, len(self._columns)))
        self._taken = 0
        self._ahead = [np.zeros(0) for _ in self._columns]

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next `count` samples in N or mV, shape (count, channels)."""
        first, self._taken = self._taken, self._taken + count
        while self._taken > len(self._ready):
            self._ready = np.concatenate([self._ready[first:], self._next_beat()])
            first, self._taken = 0, self._taken - first
        return self._ready[first : self._taken]

    def _next_beat(self) -> NDArray[np.float64]:
        """Draw one beat in each channel, and return the samples that are final in all."""
        beat = self._heart.next_beat()
        self.beats.append(beat)
        ahead = [
            np.concatenate([known, column.draw(beat)])
            for known, column in zip(self._ahead, self._columns, strict=True)
        ]
        count = min(map(len, ahead))
        self._ahead = [known[count:] for known in ahead]
        return np.stack([known[:count] for known in ahead], axis=1)


class PulseColumn:
    """The pulse at one place of the artery, which it reaches `delay_s` after its onset.

    The pulse is drawn at times shifted by the delay, which so need not be whole samples.
    """

    def __init__(
        self,
        scene: SyntheticScene,
        name: str,
        delay_s: float,
        period_s: float,
        rng: np.random.Generator,
    ) -> None:
        self.channel = Channel(name)
        self._scene, self._delay_s, self._period_s, self._rng = scene, delay_s, period_s, rng
        self._waves = PRESETS[scene.preset]
        # Mean and deviation of an endless series of nominal beats, and newtons per unit.
        beat_s = 1 / scene.heart_rate_hz
        t_s, stretch = np.arange(0, beat_s, 1e-4), math.sqrt(beat_s / NOMINAL_BEAT_S)
        beats = [_shape(self._waves, t_s - shift * beat_s, stretch) for shift in range(-3, 4)]
        row = np.sum(beats, axis=0)
        self._mean, self._deviation = float(row.mean()), float(row.std())
        self._scale_n = scene.peak_to_peak_n / float(np.ptp(row))
        widest = max(wave.width_s for wave in self._waves)
        # A beat's first wave may begin before the beat; earlier samples than this are final.
        lead_s = max(0.0, *(REACH * w.width_s - w.centre_s for w in self._waves))
        self._lead = math.ceil(1.5 * (lead_s + widest) / self._period_s)
        self._pending = np.zeros(0)
        self._pending_first = -self._lead

    def draw(self, beat: Heartbeat) -> NDArray[np.float64]:
        """Draw one beat, and return the samples in N that no later beat can change."""
        onset = round(beat.onset_s / self._period_s)
        end_s = max(w.centre_s + REACH * w.width_s for w in self._waves) * beat.stretch
        first = onset - self._lead
        last = onset + math.ceil((end_s + self._delay_s) / self._period_s)
        self._extend(last)
        indices = np.arange(max(first, self._pending_first), last)
        t_s = indices * self._period_s - beat.onset_s - self._delay_s
        self._pending[indices - self._pending_first] += beat.amplitude * _shape(
            self._waves, t_s, beat.stretch
        )
        return self._finish(round(beat.next_onset_s / self._period_s) - self._lead)

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
            rad_per_s = 2 * math.pi * scene.respiration_rate_hz
            breath = np.sin(rad_per_s * indices * self._period_s - rad_per_s * self._delay_s)
            unit = unit + scene.respiration * self._deviation * math.sqrt(2) * breath
        force_n = scene.preload_n + self._scale_n * unit
        if scene.noise_n:
            force_n = force_n + scene.noise_n * self._rng.standard_normal(count)
        if scene.hum_n:
            hum = np.sin(2 * math.pi * scene.hum_rate_hz * indices * self._period_s)
            force_n = force_n + scene.hum_n * hum
        return force_n[indices >= 0]


def _shape(
    waves: tuple[Wave, ...], t_s: NDArray[np.floating[Any]], stretch: float
) -> NDArray[np.float64]:
    """Return one beat at times after its onset."""
    shape = np.zeros(len(t_s))
    for wave in waves:
        z = (t_s - wave.centre_s * stretch) / (wave.width_s * stretch)
        shape += wave.amplitude * np.exp(-0.5 * z * z)
    return shape
