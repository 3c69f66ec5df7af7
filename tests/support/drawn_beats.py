"""Drawn pulses whose beats are known, frames of them, and their analysis."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from display_node.prediction.ensemble import Ensemble
from display_node.scoring.beats import Beat, BeatAnalysis
from protocol.wire.messages import ChannelSamples, channel_samples
from sensing_node.sources.heart import NOMINAL_BEAT_S
from sensing_node.sources.synthetic import PRESETS
from tests.support.drawn_pulses import (
    Beats,
    breathing,
    drawn,
    fibrillating,
    make_rhythm,
    with_ectopics,
)

Floats = NDArray[np.float64]
SECONDS, RATE_HZ, BATCH = 40.0, 1000, 5
PERIOD_NS = 1_000_000_000 // RATE_HZ
BEGIN_NS = 3_600_000_000_000
# Beats are found after the first seconds, in which the usual rise is learnt.
FOUND_FROM_S = 3.0


@dataclass(frozen=True)
class Drawn:
    """A pulse without noise, the times of its beats, and the preset of their waves."""

    force_n: Floats
    beats_s: Floats
    preset: str


def rhythm(name: str) -> Beats:
    rng = np.random.default_rng(5)
    if name == "fibrillation":
        return fibrillating(rng, SECONDS)
    beats = make_rhythm(rng, SECONDS, 0.04, lambda _: 75.0)
    return with_ectopics(beats, rng, 10) if name == "ectopic" else beats


def draw(name: str = "regular", preset: str = "wide") -> Drawn:
    beats = rhythm(name)
    pulse = drawn(beats, preset, SECONDS, NOMINAL_BEAT_S)
    begin_s = -2 * float(beats.intervals_s[0])
    times_s = begin_s + np.concatenate([[0.0], np.cumsum(beats.intervals_s)[:-1]])
    return Drawn(0.3 * breathing(pulse) + 0.3, times_s, preset)


def noisy(force_n: Floats) -> Floats:
    noise = np.random.default_rng(1).standard_normal(len(force_n))
    return force_n + 0.01 * float(force_n.std()) * noise


def frames(
    force_n: Floats, batch: int = BATCH, period_ns: int = PERIOD_NS
) -> list[tuple[int, Floats]]:
    """Cut samples into frames."""
    return [
        (BEGIN_NS + first * period_ns, force_n[first : first + batch])
        for first in range(0, len(force_n), batch)
    ]


def analysed(sent: list[tuple[int, Floats]], period_ns: int = PERIOD_NS) -> list[Beat]:
    analysis = BeatAnalysis()
    return [beat for frame in sent for beat in analysis.observe(samples(*frame, period_ns))]


def samples(first_ns: int, force_n: Floats, period_ns: int = PERIOD_NS) -> ChannelSamples:
    return channel_samples(0, first_ns, period_ns, force_n.tolist())


def seconds(t_ns: int) -> float:
    return (t_ns - BEGIN_NS) * 1e-9


def true_onset_and_peak_s(pulse: Drawn, at_s: float) -> tuple[float, float]:
    """Return the tangent's foot and the peak of the beat that begins about `at_s`, from samples."""
    first = round((at_s - 0.15) * RATE_HZ)
    wave = pulse.force_n[first : first + round(0.45 * RATE_HZ)]
    peak = int(wave.argmax())
    slopes = np.gradient(wave[: peak + 1])
    steepest = int(slopes.argmax())
    foot_n = wave[:steepest].min()
    onset = steepest - (wave[steepest] - foot_n) / slopes[steepest]
    return (first + onset) / RATE_HZ, (first + peak) / RATE_HZ


def true_notch_s(pulse: Drawn, at_s: float) -> float:
    """Return the dicrotic notch of the beat that begins at `at_s`, from samples.

    It is the least value between the centres of the tidal and the dicrotic wave as they were drawn.
    """
    following_s = float(pulse.beats_s[pulse.beats_s.searchsorted(at_s) + 1])
    stretch = math.sqrt(min(following_s - at_s, NOMINAL_BEAT_S) / NOMINAL_BEAT_S)
    _, tidal, dicrotic = PRESETS[pulse.preset]
    first, last = (round((at_s + stretch * w.centre_s) * RATE_HZ) for w in (tidal, dicrotic))
    return (first + int(pulse.force_n[first:last].argmin())) / RATE_HZ


MOVED_FROM_S, MOVED_S = 15.0, 4.0


def moved(force_n: Floats) -> Floats:
    """Add what a moving hand does: a random walk of four times the pulse's deviation."""
    first, length = round(MOVED_FROM_S * RATE_HZ), round(MOVED_S * RATE_HZ)
    walk = np.cumsum(np.random.default_rng(4).standard_normal(length))
    walk -= np.linspace(walk[0], walk[-1], length)
    disturbed = force_n.copy()
    disturbed[first : first + length] += 4 * float(force_n.std()) * walk / float(walk.std())
    return disturbed


def prediction_errors_n(predictor: Ensemble, force_n: Floats, true_n: Floats, ahead: int) -> Floats:
    """Feed a predictor; return the errors of its predictions `ahead` samples after each frame."""
    errors_n = []
    for first in range(0, len(force_n) - BATCH - ahead, BATCH):
        newest = first + BATCH - 1
        frame = samples(BEGIN_NS + first * PERIOD_NS, force_n[first : first + BATCH])
        predictor.observe(frame.times_ns, frame.forces_n)
        for _ in range(BATCH):
            predictor.work()
        found_n = predictor.predict(frame.times_ns[-1] + ahead * PERIOD_NS)
        errors_n.append(found_n - true_n[newest + ahead])
    return np.array(errors_n)
