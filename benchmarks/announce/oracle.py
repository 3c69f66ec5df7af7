"""Lower bounds of errors with an ECG: an oracle that has the generator of an announced pulse.

It has the shape of every beat before the last announced one, the distribution of the transit time,
and that of what follows from no R wave: the duration of a beat whose shape follows the interval
after it, or the height of a weak beat. It computes the mean of what can follow, given all samples.
"""

import math
from statistics import NormalDist

import numpy as np

from sensing_node.sources.heart import NOMINAL_BEAT_S
from sensing_node.sources.synthetic import PRESETS
from tests.support.announced_pulses import SHAPE_CUE, TRANSIT_S, wave_times
from tests.support.drawn_pulses import (
    NOISE,
    RATE_HZ,
    SCORED_FROM_S,
    Floats,
    breathing,
    drawn,
    drawn_beats,
    through_chain,
)

WAVES = PRESETS["wide"]
# A beat is drawn alone from this time before its onset on.
BEFORE_S, AFTER_S = 0.6, 2.0
# An R wave is found so long after it. Until then, no pulse rises for 135 ms.
LATENCY_S = 0.045
# Horizons at which only announced beats rise.
HORIZONS_MS = (20, 50, 100)
# Deviations of the onset in ms, and durations and heights of beats, over which the oracle averages.
DEVIATIONS_MS = np.arange(-15, 16)
INTERVALS_S = 0.7 * np.array(
    [max(0.45, 1 + 0.2 * NormalDist().inv_cdf((number + 0.5) / 21)) for number in range(21)]
)
HEIGHTS = np.linspace(0.3, 1.1, 17)
EVERY = 5


def score_oracle(case: tuple[str, float, int, float]) -> tuple[float, ...]:
    """Return the oracle's NRMSE for a pulse of `announced_pulses` at each of `HORIZONS_MS`.

    case: name of the pulse, its length in s, its seed, and the jitter of the transit time in s,
    above 0.
    """
    name, seconds, seed, jitter_s = case
    rhythm, _, cue = name.partition(", ")
    beats = drawn_beats(seconds, seed)[rhythm]
    onsets_s, waves_s = beats.onsets_s, wave_times(beats, jitter_s, seed)
    shaping_s = beats.intervals_s if cue == SHAPE_CUE else np.roll(beats.intervals_s, 1)
    pulse = drawn(beats, "wide", seconds, NOMINAL_BEAT_S, cue == SHAPE_CUE)
    true = through_chain(breathing(pulse) if rhythm == "variability" else pulse)
    deviation = true[round(SCORED_FROM_S * RATE_HZ) :].std()
    rng, squares = np.random.default_rng((seed, 300)), list[Floats]()
    for beat in range(len(onsets_s) - 1):
        first = max(waves_s[beat] + LATENCY_S, SCORED_FROM_S)
        last = min(waves_s[beat + 1] + LATENCY_S, seconds - max(HORIZONS_MS) / 1000)
        now = np.arange(round(first * RATE_HZ), round(last * RATE_HZ))
        if not len(now):
            continue
        height = float(beats.amplitudes[beat])
        shape = height / deviation * _beat_alone(float(shaping_s[beat]))
        if rhythm == "fibrillation" and cue == SHAPE_CUE:
            possible = np.array([_beat_alone(each) for each in INTERVALS_S.tolist()]) / deviation
        elif height < 1:
            possible = HEIGHTS[:, np.newaxis] / height * shape
        else:
            possible = shape[np.newaxis]
        # At each candidate onset and shape, the samples and what follows them.
        expected = round((waves_s[beat] + TRANSIT_S) * RATE_HZ)
        onset = round(onsets_s[beat] * RATE_HZ)
        since = now - expected - DEVIATIONS_MS[:, np.newaxis]
        sensed = _at(shape, now - onset) + NOISE * rng.standard_normal(len(now))
        misfits = (_at(possible, since) - sensed) / NOISE
        misfits *= misfits
        likelihood = np.cumsum(misfits, axis=-1)[..., ::EVERY]
        likelihood += ((DEVIATIONS_MS / (1e3 * jitter_s)) ** 2)[:, np.newaxis]
        likelihood *= -0.5
        weights = np.exp(likelihood - likelihood.max(axis=(0, 1)))
        weights /= weights.sum(axis=(0, 1))
        errors = [
            (weights * _at(possible, since[:, ::EVERY] + ahead)).sum(axis=(0, 1))
            - _at(shape, now[::EVERY] - onset + ahead)
            for ahead in HORIZONS_MS
        ]
        squares.append(np.array(errors).T ** 2)
    means = np.concatenate(squares).mean(axis=0).tolist()
    return tuple(map(math.sqrt, means))


def _beat_alone(shaping_s: float) -> Floats:
    """Return a beat of height 1 whose shape follows an interval in s, after the chain."""
    stretch = math.sqrt(min(shaping_s, NOMINAL_BEAT_S) / NOMINAL_BEAT_S)
    t_s = np.arange(round((BEFORE_S + AFTER_S) * RATE_HZ)) / RATE_HZ - BEFORE_S
    beat = np.zeros(len(t_s))
    for wave in WAVES:
        z = (t_s - wave.centre_s * stretch) / (wave.width_s * stretch)
        beat += wave.amplitude * np.exp(-0.5 * z * z)
    return through_chain(beat)


def _at(shapes: Floats, since_onset_ms: np.typing.NDArray[np.intp]) -> Floats:
    """Return shapes, shape (…, samples), at times since their onset; 0 before they begin."""
    position = np.clip(since_onset_ms + round(BEFORE_S * RATE_HZ), 0, shapes.shape[-1] - 1)
    return np.asarray(shapes[..., position])
