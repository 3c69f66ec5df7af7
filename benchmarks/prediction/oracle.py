"""Lower bounds of errors: an oracle that knows a pulse's generator, and the best linear filter.

The oracle knows the shape of a beat, when each beat began, and the distribution of the next
interval. It predicts the mean of what can follow. It does not see a beat before the first wave has
reached a given distance from its peak, and sees it before the chain has delayed it.
"""

from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from sensing_node.sources.heart import NOMINAL_BEAT_S
from sensing_node.sources.synthetic import PRESETS
from tests.support.drawn_pulses import (
    RATE_HZ,
    SCORED_FROM_S,
    Beats,
    Floats,
    Pulse,
    breathing,
    drawn,
    fibrillating,
    make_rhythm,
    through_chain,
)

WAVES = PRESETS["wide"]
# A beat is drawn alone from this time before its onset on.
BEFORE_S, AFTER_S = 0.4, 1.2
# Quantiles of the next interval over which the oracle averages.
QUANTILES = np.array([NormalDist().inv_cdf((number + 0.5) / 200) for number in range(200)])
EVERY_S = 0.025


class KnownRhythm(NamedTuple):
    """Beats, and the mean and deviation in s of each interval, given those before it."""

    beats: Beats
    expected_s: Floats
    deviation_s: float
    breathes: bool


def known_rhythms(seconds: float, seed: int) -> dict[str, KnownRhythm]:
    """Return the rhythms of two of `pulses_without_shape_cue`, by their names."""
    beats = make_rhythm(np.random.default_rng((seed, 1)), seconds, 0.04, lambda _: 75.0)
    rng = np.random.default_rng((seed, 1))
    rng.uniform()
    deviation_s = 0.8 * 0.04 * np.sqrt(0.2)
    random_s = deviation_s * rng.standard_normal(len(beats.intervals_s))
    irregular = fibrillating(np.random.default_rng((seed, 9)), seconds)
    return {
        "variability": KnownRhythm(beats, beats.intervals_s - random_s, deviation_s, True),
        "fibrillation": KnownRhythm(
            irregular, np.full(len(irregular.intervals_s), 0.7), 0.14, False
        ),
    }


def oracle_errors(
    rhythm: KnownRhythm, seconds: float, visible_widths: float, horizons_ms: tuple[int, ...]
) -> tuple[float, ...]:
    """Return the oracle's NRMSE at each horizon, after `SCORED_FROM_S`.

    Parameters
    ----------
    visible_widths
        A beat is visible from this number of widths (standard deviations) before the peak of its
        first wave.
    """
    intervals_s = rhythm.beats.intervals_s
    onsets_s = np.concatenate([[0.0], np.cumsum(intervals_s)[:-1]]) - 2 * intervals_s[0]
    stretches = np.sqrt(np.minimum(np.roll(intervals_s, 1), NOMINAL_BEAT_S) / NOMINAL_BEAT_S)
    visible = (WAVES[0].centre_s - visible_widths * WAVES[0].width_s) * stretches
    pulse = drawn(rhythm.beats, "wide", seconds, NOMINAL_BEAT_S, predictive_shape=False)
    true = through_chain(breathing(pulse) if rhythm.breathes else pulse)
    squares = np.zeros(len(horizons_ms))
    instants_s = np.arange(SCORED_FROM_S, seconds - max(horizons_ms) / 1000, EVERY_S)
    ahead_s = np.array(horizons_ms) / 1000
    alone = [through_chain(_beat_alone(stretch)) for stretch in stretches]
    for now_s in instants_s.tolist():
        last = int(np.searchsorted(onsets_s + visible, now_s, side="right")) - 1
        expected_s = rhythm.expected_s[last] + rhythm.deviation_s * QUANTILES
        possible_s = onsets_s[last] + np.maximum(expected_s, 0.45 * rhythm.expected_s[last])
        # Had it come earlier, the next beat would be visible.
        coming_s = possible_s[possible_s + visible[last + 1] > now_s]
        if not len(coming_s):
            coming_s = np.array([now_s - visible[last + 1]])
        shape, at_s = alone[last + 1], now_s + ahead_s[:, np.newaxis]
        predicted = _at(shape, at_s - coming_s).mean(axis=1)
        squares += (predicted - _at(shape, at_s - onsets_s[last + 1])[:, 0]) ** 2
    deviation = true[round(SCORED_FROM_S * RATE_HZ) :].std()
    return tuple((np.sqrt(squares / len(instants_s)) / deviation).tolist())


# Taps of a filter, which are means over 5 ms, as in the predictors' grid, of the last 1.3 s.
TAP_MS, TAPS = 5, 260
# Each part of a set is predicted by a filter that is fitted to everything else, except for this
# number of cells on both sides, whose values overlap with it.
PARTS, APART = 20, 50


def best_filter_errors(pulse: Pulse, horizons_ms: tuple[int, ...]) -> tuple[float, ...]:
    """Return the NRMSE of the best fixed linear filter of x(t−i) − x(t) at each horizon.

    A filter that learns has only the values before; this one is fitted to those after, too, but not
    to the ones that it predicts.
    """
    count = len(pulse.sensed) // TAP_MS
    cells = pulse.sensed[: count * TAP_MS].reshape(count, TAP_MS).mean(axis=1)
    at = np.arange(TAPS + 1, (len(pulse.true) - max(horizons_ms)) // TAP_MS - 1)
    newest = cells[at]
    inputs = cells[at[:, np.newaxis] - np.arange(1, TAPS + 1)] - newest[:, np.newaxis]
    ends = at * TAP_MS + TAP_MS - 1
    wanted = pulse.true[ends[:, np.newaxis] + np.array(horizons_ms)] - newest[:, np.newaxis]
    # The ridge is far below the noise: larger ones have larger errors.
    products, results = inputs.T @ inputs + 1e-3 * np.eye(TAPS), inputs.T @ wanted
    scored = np.flatnonzero(at >= round(SCORED_FROM_S * RATE_HZ) // TAP_MS)
    squares = np.zeros(len(horizons_ms))
    for part in np.array_split(scored, PARTS):
        near = slice(max(int(part[0]) - APART, 0), int(part[-1]) + APART + 1)
        known = products - inputs[near].T @ inputs[near]
        weights = np.linalg.solve(known, results - inputs[near].T @ wanted[near])
        squares += np.sum((wanted[part] - inputs[part] @ weights) ** 2, axis=0)
    return tuple(np.sqrt(squares / len(scored)).tolist())


def _beat_alone(stretch: float) -> Floats:
    t_s = np.arange(round((BEFORE_S + AFTER_S) * RATE_HZ)) / RATE_HZ - BEFORE_S
    beat = np.zeros(len(t_s))
    for wave in WAVES:
        z = (t_s - wave.centre_s * stretch) / (wave.width_s * stretch)
        beat += wave.amplitude * np.exp(-0.5 * z * z)
    return beat


def _at(shape: Floats, since_onset_s: Floats) -> Floats:
    position = np.round((since_onset_s + BEFORE_S) * RATE_HZ).astype(int)
    return np.asarray(shape[np.clip(position, 0, len(shape) - 1)])
