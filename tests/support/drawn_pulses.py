"""Pulses on which predictors are compared: synthetic rhythms, recordings, and frames of them.

A rhythm is a list of beats; a pulse is a sum of Gaussians over each beat, as in
`sources/synthetic.py`, which has neither a ramp nor fibrillation. All pulses pass the same causal
filters of 0.4 to 20 Hz; then white noise of 1 % of their standard deviation is added.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from sensing_node.files.formats import open_signals
from sensing_node.sources.heart import NOMINAL_BEAT_S
from sensing_node.sources.synthetic import PRESETS, REACH

Floats = NDArray[np.float64]
RATE_HZ = 1000
HIGH_PASS_HZ, LOW_PASS_HZ = 0.4, 20.0
NOISE = 0.01
# Errors and standard deviation are computed from this time on: before it, predictors learn.
SCORED_FROM_S = 20.0
# A frame has 5 samples, one for each tick; the sensing clock begins at an arbitrary time.
FRAME = 5
BEGIN_NS = 3_600_000_000_000
# Times ahead at which predictions are compared.
HORIZONS_MS = (20, 50, 100, 200)
BREATHS_HZ = 0.25
# RMS of the respiration over the RMS of the pulse, in pulses with respiration.
BREATH = 0.1


Found = TypeVar("Found", covariant=True)


class SampleObserver(Protocol[Found]):
    """What takes a frame's samples."""

    def observe(self, times_ns: list[int], values: list[float]) -> Found:
        """Take the samples."""


class Beats(NamedTuple):
    """Intervals in s from each beat to the next, and amplitudes relative to a normal beat."""

    intervals_s: Floats
    amplitudes: Floats

    @property
    def onsets_s(self) -> Floats:
        """When each beat begins in s; the first two begin before time 0."""
        begins_s: Floats = np.concatenate([[0.0], np.cumsum(self.intervals_s)[:-1]])
        return begins_s - 2 * float(self.intervals_s[0])


@dataclass(frozen=True, slots=True)
class Pulse:
    """A pulse as sensed, and the same without noise, in units of its standard deviation.

    rate_hz: of both. frame: number of samples in a frame. A sample that is lost, in a gap, is not a
    number in `sensed`.
    """

    name: str
    sensed: Floats
    true: Floats
    rate_hz: float = RATE_HZ
    frame: int = FRAME

    def __str__(self) -> str:
        return self.name


class RecordedStretch(NamedTuple):
    """A stretch of a recording in the package heartpy."""

    file: str
    column: int
    rate_hz: float
    from_s: float


def make_rhythm(
    rng: np.random.Generator, seconds: float, variability: float, bpm: Callable[[float], float]
) -> Beats:
    """Make beats whose rate follows `bpm` (of the time in s), with heart-rate variability.

    A slow and a respiratory rhythm each make two fifths of the intervals' variance; the rest is
    random, as in `sources/synthetic.py`.
    """
    onset_s, phase_rad, intervals_s = 0.0, rng.uniform(0, 2 * math.pi), []
    while onset_s < seconds + 5:
        waves = math.sin(2 * math.pi * 0.1 * onset_s + phase_rad)
        waves += math.sin(2 * math.pi * BREATHS_HZ * onset_s)
        unit = math.sqrt(0.8) * waves + math.sqrt(0.2) * rng.standard_normal()
        intervals_s.append(60 / bpm(onset_s) * max(0.4, 1 + variability * unit))
        onset_s += intervals_s[-1]
    return Beats(np.array(intervals_s), np.ones(len(intervals_s)))


def with_ectopics(beats: Beats, rng: np.random.Generator, one_in: int) -> Beats:
    """Make one random beat in `one_in` early and weak, with a pause after it."""
    intervals_s, amplitudes = beats.intervals_s.copy(), beats.amplitudes.copy()
    for first in range(0, len(intervals_s) - one_in, one_in):
        beat = first + int(rng.integers(one_in - 1))
        intervals_s[beat] *= 0.6
        intervals_s[beat + 1] *= 1.4
        amplitudes[beat + 1] *= 0.6
    return Beats(intervals_s, amplitudes)


def fibrillating(rng: np.random.Generator, seconds: float) -> Beats:
    """Make independent intervals of 0.7 s with a deviation of a fifth."""
    count = math.ceil((seconds + 5) / 0.7 * 1.2)
    intervals_s = 0.7 * np.maximum(0.45, 1 + 0.2 * rng.standard_normal(count))
    return Beats(intervals_s, np.ones(count))


def drawn(
    beats: Beats, preset: str, seconds: float, nominal_s: float, predictive_shape: bool = True
) -> Floats:
    """Draw the pulse of some beats at 1 kHz; an interval above `nominal_s` lengthens no systole.

    With `predictive_shape`, a beat's systole scales with its own interval, as in
    `sources/synthetic.py`, so that its shape predicts the next beat. Otherwise it scales with the
    interval before, and only the rhythm predicts the next beat.
    """
    t_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    pulse, onset_s = np.zeros(len(t_s)), -2 * float(beats.intervals_s[0])
    shaping_s = beats.intervals_s if predictive_shape else np.roll(beats.intervals_s, 1)
    for interval_s, shape_s, amplitude in zip(
        beats.intervals_s, shaping_s, beats.amplitudes, strict=True
    ):
        stretch = math.sqrt(min(float(shape_s), nominal_s) / NOMINAL_BEAT_S)
        for wave in PRESETS[preset]:
            centre_s, width_s = onset_s + wave.centre_s * stretch, wave.width_s * stretch
            first, last = np.searchsorted(t_s, centre_s + REACH * width_s * np.array([-1, 1]))
            z = (t_s[first:last] - centre_s) / width_s
            pulse[first:last] += amplitude * wave.amplitude * np.exp(-0.5 * z * z)
        onset_s += float(interval_s)
    return pulse


def breathing(pulse: Floats) -> Floats:
    """Add a respiratory wave to the pulse."""
    t_s = np.arange(len(pulse)) / RATE_HZ
    wave = math.sqrt(2) * np.sin(2 * np.pi * BREATHS_HZ * t_s)
    return np.asarray(pulse + BREATH * pulse.std() * wave)


def drawn_beats(seconds: float, seed: int) -> dict[str, Beats]:
    """Return the beats of the synthetic pulses by name."""

    def rng(number: int) -> np.random.Generator:
        return np.random.default_rng((seed, number))

    def rhythm(number: int, variability: float) -> Beats:
        return make_rhythm(rng(number), seconds, variability, lambda _: 75.0)

    return {
        "steady": rhythm(0, 0.0),
        "variability": rhythm(1, 0.04),
        "variability, sharp": rhythm(2, 0.04),
        "variability, twice": rhythm(3, 0.08),
        "ramp": make_rhythm(rng(4), seconds, 0.0, lambda t_s: 60 + 60 * min(t_s / seconds, 1)),
        "ectopic": with_ectopics(rhythm(5, 0.02), rng(6), 20),
        "ectopic, twice": with_ectopics(rhythm(7, 0.04), rng(8), 10),
        "fibrillation": fibrillating(rng(9), seconds),
    }


# Pulses without respiration.
STILL = ("ramp", "ectopic", "fibrillation")


def synthetic_pulses(seconds: float, seed: int, predictive_shape: bool = True) -> dict[str, Floats]:
    """Return eight pulses by name, before the chain."""
    made = {}
    for name, beats in drawn_beats(seconds, seed).items():
        preset = "paper" if name == "variability, sharp" else "wide"
        nominal_s = 1.0 if name == "ramp" else NOMINAL_BEAT_S
        pulse = drawn(beats, preset, seconds, nominal_s, predictive_shape)
        made[name] = pulse if name in STILL else breathing(pulse)
    return made


WITHOUT_SHAPE_CUE = ("variability", "ramp", "ectopic", "fibrillation")
RECORDED = {
    "heartpy data": RecordedStretch("data.csv", 0, 100.0, 0.0),
    "heartpy data2": RecordedStretch("data2.csv", 1, 117.0, 45.0),
    "heartpy data3, early": RecordedStretch("data3.csv", 1, 100.4, 20.0),
    "heartpy data3, late": RecordedStretch("data3.csv", 1, 100.4, 330.0),
}
"""Stretches without movement; rates from their time stamps, or from heartpy's manual (first)."""


def recorded_pulses(seconds: float) -> dict[str, Floats]:
    """Return the recordings of the package heartpy at 1 kHz; none where it is not installed.

    Raises SourceError when they cannot be read.
    """
    package = find_spec("heartpy")
    if package is None or package.origin is None:
        return {}
    pulses = {}
    for name, (file, column, rate_hz, from_s) in RECORDED.items():
        first = round(from_s * rate_hz)
        path = Path(package.origin).parent / "data" / file
        recorded = open_signals(path).load((column,))[0].values
        values = recorded[first : first + round(seconds * rate_hz)]
        given_s = np.arange(len(values)) / rate_hz
        pulses[name] = np.interp(np.arange(0, given_s[-1], 1 / RATE_HZ), given_s, values)
    return pulses


def through_chain(pulse: Floats) -> Floats:
    """Apply a first-order high-pass and a fourth-order Butterworth low-pass, settled at first."""
    from scipy.signal import butter, sosfilt, sosfilt_zi

    high = butter(1, HIGH_PASS_HZ, "highpass", fs=RATE_HZ, output="sos")
    sections = np.concatenate([high, butter(4, LOW_PASS_HZ, fs=RATE_HZ, output="sos")])
    filtered, _ = sosfilt(sections, pulse, zi=sosfilt_zi(sections) * pulse[0])
    return np.asarray(filtered)


def pulses(seconds: float, seed: int) -> list[Pulse]:
    """Return all sets: twelve, or eight without heartpy. Raises SourceError."""
    return _sensed(synthetic_pulses(seconds, seed) | recorded_pulses(seconds), seed)


def pulses_without_shape_cue(seconds: float, seed: int) -> list[Pulse]:
    """Return the sets with a stretch goal or an oracle, with shapes that predict no interval."""
    raw = synthetic_pulses(seconds, seed, predictive_shape=False)
    return _sensed({name: raw[name] for name in WITHOUT_SHAPE_CUE}, seed)


def _sensed(raw: dict[str, Floats], seed: int) -> list[Pulse]:
    made = []
    for number, (name, pulse) in enumerate(raw.items()):
        true = through_chain(pulse)
        true = true / true[round(SCORED_FROM_S * RATE_HZ) :].std()
        noise = np.random.default_rng((seed, 100 + number)).standard_normal(len(true))
        made.append(Pulse(name, true + NOISE * noise, true))
    return made


def observe_frame(observer: SampleObserver[Found], sensed: Floats, frame: int) -> Found:
    """Give a frame's samples to a predictor or detector."""
    samples = range(frame * FRAME, frame * FRAME + FRAME)
    values = sensed[samples.start : samples.stop].tolist()
    return observer.observe([instant_ns(number) for number in samples], values)


def instant_ns(sample: int) -> int:
    """Return the time of a sample on the sensing clock."""
    return BEGIN_NS + sample * (1_000_000_000 // RATE_HZ)
