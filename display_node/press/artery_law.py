"""The artery under the probe as the finger models it: a tube law, fitted to beats. Pure.

The law has five parameters with a meaning: gain of the film, mean arterial and pulse pressure as
forces of the probe, and the two constants of the tube. So what is learnt at some hold-down forces
predicts the others, where a curve without a law returns to a typical artery.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.tissue import COLLAPSE_PER_PA, TubeLaw

Floats = NDArray[np.float64]
# Mean arterial pressure and pulse pressure of a typical wrist under a probe of 1 cm², as forces;
# mean pressure above diastole, as a share of the pulse pressure.
TYPICAL_MEAN_N, TYPICAL_PULSE_N, MEAN_SHARE = 1.2, 0.52, 0.27
PA_PER_N: Final = 1e4
# Deviations of the logarithms from the typical artery: of the gain, and of persons' mean pressure,
# pulse pressure, collapse and distension; a stiff artery's constants are 0.7 of a normal one's.
GAIN_DEVIATION: Final = 2.0
DEVIATIONS: Final = (0.3, 0.35, 0.2, 0.3)
# The probe's area changes all of them together: forces by its factor, constants by its reciprocal.
AREA_DEVIATION: Final = 0.3
MOST_DEVIATIONS: Final = 4.0
# Steps of a fit, their first damping, and the change for derivatives.
STEPS, DAMPING, CHANGE = 3, 1e-2, 1e-4
# Further starts: ln(mean pressure) from the typical one. Each of the first fits tries one of them,
# and later one in SELDOM; a fit takes half a millisecond of the display's loop without it.
STARTS: Final = (-0.5, -0.25, 0.0, 0.25, 0.5)
MANY_FITS, SELDOM = 30, 7
# Relative pressures are bounded, as noise on a closed or a wide artery would explain any.
LOWEST, HIGHEST = -1.0, 2.0
# Where the artery is open in diastole, pressures so far below the least plausible one are seen.
SEEN: Final = 0.7
# Where it is closed, readings of this share of the height are noise, and count as the foot.
UNSEEN: Final = 0.004


@dataclass(frozen=True, slots=True)
class ArteryLaw:
    """Height and shape of the pulse at the film against the hold-down force.

    Attributes
    ----------
    gain
        Height in N per N of volume pulse.
    diastolic_n, pulse_n
        Diastolic pressure and pulse pressure, times the probe's area.
    collapse_per_n, distension_per_n
        Constants of the tube's law, over the probe's area.
    """

    gain: float
    diastolic_n: float
    pulse_n: float
    collapse_per_n: float
    distension_per_n: float

    def heights(self, forces_n: Floats) -> Floats:
        """Return the pulse's heights at hold-down forces."""
        return self._volumes(self.diastolic_n + self.pulse_n - forces_n) - self._volumes(
            self.diastolic_n - forces_n
        )

    def _volumes(self, transmural_n: Floats) -> Floats:
        a, b = self.collapse_per_n, self.distension_per_n
        closed = np.exp(a * np.minimum(transmural_n, 0.0)) / a
        return self.gain * (closed - np.expm1(-b * np.maximum(transmural_n, 0.0)) / b)

    def share(self, pressure: float, force_n: float) -> float:
        """Return the film's reading above its foot, over the height, at a hold-down force.

        pressure: of the artery, 0 at the typical diastole and 1 at the typical systole.
        """
        tube, low_n = self._tube(), self.diastolic_n - force_n
        foot = tube.volume(low_n)
        return (tube.volume(low_n + pressure * self.pulse_n) - foot) / (
            tube.volume(low_n + self.pulse_n) - foot
        )

    def slope(self, pressure: float, force_n: float) -> float:
        """Return the change of `share` with the pressure, at a pressure and hold-down force."""
        more, less = (self.share(pressure + change, force_n) for change in (0.01, -0.01))
        return (more - less) / 0.02

    def pressure(self, share: float, force_n: float, least: float = -math.inf) -> float:
        """Return the artery's pressure for a reading, as `share` is its inverse.

        least: lowest pressure that is plausible where the artery is closed, and the reading
        contains noise only. Where it is open, lower ones are seen.
        """
        tube, low_n = self._tube(), self.diastolic_n - force_n
        a, b = self.collapse_per_n, self.distension_per_n
        foot = tube.volume(low_n)
        open_share = math.exp(a * min(low_n, 0.0))
        unseen = max(UNSEEN * (1.0 - open_share), 1e-9)
        share -= unseen * math.exp(-max(share, 0.0) / unseen)
        volume = foot + share * (tube.volume(low_n + self.pulse_n) - foot)
        if volume <= 0.0:
            transmural_n = -math.inf
        elif volume < 1 / a:
            transmural_n = math.log(a * volume) / a
        else:
            transmural_n = -math.log(max(1 - b * (volume - 1 / a), 1e-9)) / b
        pressure = (transmural_n - low_n) / self.pulse_n
        return min(max(pressure, least - SEEN * open_share, LOWEST), HIGHEST)

    def _tube(self) -> TubeLaw:
        return TubeLaw(self.collapse_per_n, self.distension_per_n)


class ArteryFit:
    """The law that explains heights of beats best, among those near a typical artery.

    Regularised least squares in the logarithms of the parameters.
    """

    def __init__(self) -> None:
        tube = TubeLaw.highest_at_mean(MEAN_SHARE)
        constants = PA_PER_N * COLLAPSE_PER_PA, PA_PER_N * tube.distension_per_pa
        self._typical = np.log([1.0, TYPICAL_MEAN_N, TYPICAL_PULSE_N, *constants])
        area = AREA_DEVIATION * np.array([0.0, 1.0, 1.0, -1.0, -1.0])
        self._prior = np.diag(np.square([GAIN_DEVIATION, *DEVIATIONS])) + np.outer(area, area)
        self._weights = np.linalg.inv(self._prior)
        self._bounds = MOST_DEVIATIONS * np.sqrt(np.diag(self._prior))
        self._values, self._covariance = self._typical.copy(), self._prior.copy()
        self._fits = 0
        self.law = _law(self._values)

    def scale(self, log_gain: float) -> None:
        """Change the unit of the heights, before anything is fitted."""
        self._typical[0] += log_gain
        self._values[0] += log_gain
        self.law = _law(self._values)

    def fit(self, forces_n: Floats, logs: Floats, variances: Floats) -> None:
        """Fit the law to logarithms of heights, of these variances, at hold-down forces.

        A second start from an artery of another mean pressure keeps it out of a minimum that only
        its vicinity has; later it is tried seldom.
        """
        self._fits += 1
        starts = [self._values]
        if self._fits <= MANY_FITS or self._fits % SELDOM == 0:
            other = self._typical.copy()
            other[1] += STARTS[self._fits % len(STARTS)]
            starts.append(other)
        fits = [self._descend(start, forces_n, logs, variances) for start in starts]
        _, self._values, self._covariance = min(fits, key=lambda each: each[0])
        self.law = _law(self._values)

    def _descend(
        self, values: Floats, forces_n: Floats, logs: Floats, variances: Floats
    ) -> tuple[float, Floats, Floats]:
        """Return cost, values and their covariance after steps of Levenberg and Marquardt."""
        typical, weights = self._typical, self._weights
        low, high = typical - self._bounds, typical + self._bounds

        def errors_at(values: Floats) -> tuple[float, Floats]:
            errors = logs - self._logs(values, forces_n)
            away = values - typical
            return float(errors @ (errors / variances) + away @ weights @ away), errors

        (cost, errors), damping = errors_at(values), DAMPING
        for _ in range(STEPS):
            slopes = self._slopes(values, forces_n)
            normal = (slopes / variances) @ slopes.T + weights
            pull = (slopes / variances) @ errors + weights @ (typical - values)
            step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), pull)
            trial = np.clip(values + step, low, high)
            trial_cost, trial_errors = errors_at(trial)
            if trial_cost < cost:
                values, cost, errors, damping = trial, trial_cost, trial_errors, damping / 10
            else:
                damping *= 10
        return cost, values, np.linalg.inv(normal)

    def deviations(self, forces_n: Floats) -> Floats:
        """Return the standard deviations of the logarithm of the height at forces."""
        slopes = self._slopes(self._values, forces_n)
        variances = np.einsum("if,ij,jf->f", slopes, self._covariance, slopes)
        deviations: Floats = np.sqrt(np.maximum(variances, 0.0))
        return deviations

    @staticmethod
    def _logs(values: Floats, forces_n: Floats) -> Floats:
        """Return logarithms of the height; values: the parameters' or columns of these."""
        gain, mean_n, pulse_n, a, b = np.exp(values)[..., None]
        low_n = mean_n - MEAN_SHARE * pulse_n - forces_n
        ends = np.stack([low_n + pulse_n, low_n])
        closed = np.exp(a * np.minimum(ends, 0.0)) / a
        high, low = closed - np.expm1(-b * np.maximum(ends, 0.0)) / b
        logs: Floats = np.log(np.maximum(gain * (high - low), 1e-12))
        return logs

    def _slopes(self, values: Floats, forces_n: Floats) -> Floats:
        """Return the derivatives of the logarithm of the height, one row a parameter."""
        shifts = CHANGE * np.eye(len(values))
        changed = values[:, None] + np.concatenate([shifts, -shifts], axis=1)
        more, less = np.split(self._logs(changed, forces_n), 2)
        slopes: Floats = (more - less) / (2 * CHANGE)
        return slopes


def _law(values: Floats) -> ArteryLaw:
    gain, mean_n, pulse_n, collapse, distension = np.exp(values).tolist()
    return ArteryLaw(gain, mean_n - MEAN_SHARE * pulse_n, pulse_n, collapse, distension)
