"""Respiration in the arterial pressure: the wave through the newest beats. Pure.

Pressures are relative to the pulse pressure.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# Deviation of the wave, and its largest size. Persons breathe 8 to 25 times a minute.
WAVE, MOST_WAVE = 0.06, 0.12
RATES: Final = np.linspace(0.9, 2.6, 18)
NEAR_RATES: Final = np.linspace(-0.08, 0.08, 9)
# A wave is fitted to the beats of this time, at least so many; beats count less with their age, as
# respiration is not regular for longer.
FITTED_S, FEWEST_BEATS, REGULAR_S = 30.0, 8, 20.0
# The best of all rates explains so many times the variance of deviations without a rhythm.
CHANCE: Final = 6.0
# Bounds of what a beat deviates from the fitted wave.
LEAST_DOUBT, MOST_DOUBT = 0.02, 0.08


class FittedWave(NamedTuple):
    """A sine through the respiratory pressures of the newest beats.

    Attributes
    ----------
    rad_per_s
        Its rate.
    zero_s, cosine, sine
        Time from which its phase counts, and its amplitudes.
    deviation
        RMS of what a beat deviates from it.
    """

    rad_per_s: float
    zero_s: float
    cosine: float
    sine: float
    deviation: float

    def at(self, times_s: Floats) -> Floats:
        """Return the wave at times."""
        angles = self.rad_per_s * (times_s - self.zero_s)
        wave: Floats = self.cosine * np.cos(angles) + self.sine * np.sin(angles)
        return wave

    def ahead(self, time_s: float) -> float:
        """Return what is expected at a later time; with its distance, less is known."""
        since_s = time_s - self.zero_s
        angle, kept = self.rad_per_s * since_s, math.exp(-abs(since_s) / REGULAR_S)
        wave = kept * (self.cosine * math.cos(angle) + self.sine * math.sin(angle))
        return min(max(wave, -MOST_WAVE), MOST_WAVE)


def fit_wave(times_s: Floats, pressures: Floats, now_s: float) -> FittedWave | None:
    """Return the sine without a mean that fits the newest beats best; None for too few of them.

    Its amplitudes are lowered by what the best rate would explain of chance alone.

    Parameters
    ----------
    times_s, pressures
        Beats, in any order.
    now_s
        The present; beats of the last `FITTED_S` count.
    """
    recent = times_s > now_s - FITTED_S
    count = int(recent.sum())
    if count < FEWEST_BEATS:
        return None
    since_s = times_s[recent] - now_s
    weights = np.exp(since_s / REGULAR_S)
    seen = pressures[recent] - weights @ pressures[recent] / weights.sum()
    near = RATES[_fit_sines(RATES, since_s, weights, seen)[2].argmax()] + NEAR_RATES
    cosine, sine, explained = _fit_sines(near, since_s, weights, seen)
    at = int(explained.argmax())
    rest = max(float(weights @ seen**2 - explained[at]), 0.0) / float(weights.sum())
    rest *= count / (count - 3)
    kept = max(0.0, 1.0 - CHANCE * rest / max(float(explained[at]), 1e-12))
    deviation = min(max(math.sqrt(rest), LEAST_DOUBT), MOST_DOUBT)
    return FittedWave(
        float(near[at]), now_s, kept * float(cosine[at]), kept * float(sine[at]), deviation
    )


def _fit_sines(
    rates: Floats, since_s: Floats, weights: Floats, seen: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return amplitudes of cosine and sine at each rate, and what they explain of the squares."""
    angles = rates[:, None] * since_s
    cosines, sines = np.cos(angles), np.sin(angles)
    least = (LEAST_DOUBT / WAVE) ** 2
    cc, ss = cosines**2 @ weights + least, sines**2 @ weights + least
    cs, cy, sy = (cosines * sines) @ weights, cosines @ (weights * seen), sines @ (weights * seen)
    scale = cc * ss - cs**2
    cosine, sine = (ss * cy - cs * sy) / scale, (cc * sy - cs * cy) / scale
    return cosine, sine, cosine * cy + sine * sy
