"""The differencing observer: how often a difference is told apart, and the least that is.

What is felt of an interval is one number, its force error in units of the threshold, and noise of
deviation 1. X is called what it is nearer to: the differencing strategy of Macmillan and Creelman,
*Detection Theory*, ch. 9. At the threshold d' is 1.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr

Floats = NDArray[np.float64]

LARGEST = 20.0
STEPS = 4_000
DECADES = 3
# Half of the 95 % point of chi square with one degree of freedom.
LOG_LIKELIHOOD_DROP = 1.920729


class Errors(NamedTuple):
    """Force errors of a trial's intervals, in one unit."""

    a: float
    b: float
    x: float


def says_a(errors: Errors, threshold: float | Floats) -> Floats:
    """Probability that X is called A.

    |x − a| < |x − b| where a − b and x − (a + b)/2 have the same sign; with noise of deviation 1
    they are independent, of variances 2 and 3/2.
    """
    apart = (errors.a - errors.b) / np.asarray(threshold) / math.sqrt(2)
    aside = (errors.x - (errors.a + errors.b) / 2) / np.asarray(threshold) / math.sqrt(1.5)
    return np.asarray(ndtr(apart) * ndtr(aside) + ndtr(-apart) * ndtr(-aside))


def proportion_correct(d_prime: float) -> float:
    """Share of right answers of ABX where A and B are d' apart."""
    return float(says_a(Errors(d_prime, 0.0, d_prime), 1.0))


def d_prime(share: float) -> float:
    """The d' that gives a share of right answers; 0 at a half and below, infinite at 1."""
    if share <= 0.5:
        return 0.0
    if share >= proportion_correct(LARGEST):
        return math.inf
    return float(brentq(lambda d: proportion_correct(d) - share, 0.0, LARGEST))


@dataclass(frozen=True, slots=True)
class Threshold:
    """The error at which d' is 1, and the interval of its 95 % profile likelihood; 0 and infinity
    where the answers set no bound."""

    value: float
    low: float
    high: float


def fit_threshold(trials: Sequence[tuple[Errors, bool]]) -> Threshold | None:
    """The threshold that makes the answers likeliest; each trial's errors and whether X was
    called A. None where the answers set no bound at either side, as too few or mere guesses."""
    largest = max((abs(errors.a - errors.b) for errors, _ in trials), default=0.0)
    if largest == 0:
        return None
    tried = largest * np.logspace(-DECADES, DECADES, STEPS)
    likelihood = np.zeros(STEPS)
    for errors, said_a in trials:
        chance = says_a(errors, tried)
        likelihood += np.log(np.maximum(chance if said_a else 1 - chance, 1e-300))
    best = int(np.argmax(likelihood))
    within = np.flatnonzero(likelihood > likelihood[best] - LOG_LIKELIHOOD_DROP)
    low = 0.0 if within[0] == 0 else float(tried[within[0]])
    high = math.inf if within[-1] == STEPS - 1 else float(tried[within[-1]])
    return None if low == 0 and high == math.inf else Threshold(float(tried[best]), low, high)
