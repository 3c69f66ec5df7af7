"""Statistics of blinded trials: proportions, the differencing observer, the number of trials.

The observer's percept of an interval is one number: the force error in units of the threshold,
plus noise of standard deviation 1. In an ABX trial X is identified as the nearer one of A and B.
This is the
differencing strategy of Macmillan and Creelman, *Detection Theory*, ch. 9. At the threshold, d' is
1.
"""

import math
from collections.abc import Sequence
from random import Random
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr
from scipy.stats import binom, binomtest

from telepulse.document import Chapter, Report, Table

CHANCE = 0.5
LEVEL = 0.05
MOST_TRIALS = 5_000
Floats = NDArray[np.float64]
MAX_D_PRIME = 20.0
THRESHOLD_STEPS = 4_000
THRESHOLD_DECADES = 3
# Half of the 95 % point of chi square with one degree of freedom.
LOG_LIKELIHOOD_DROP = 1.920729


class Proportion(NamedTuple):
    """A number of hits in a number of trials."""

    hits: int
    of: int

    @property
    def share(self) -> float:
        """Share of hits, from 0 to 1."""
        return self.hits / self.of

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson interval: contains the true share in at least 95 % of all cases."""
        found = binomtest(self.hits, self.of).proportion_ci(1 - LEVEL, method="exact")
        return float(found.low), float(found.high)

    @property
    def p_value(self) -> float:
        """Probability of as many hits or more by guessing between two."""
        return float(binomtest(self.hits, self.of, CHANCE, alternative="greater").pvalue)


PAPER = Proportion(4, 6)
"""The paper's section 5.4: 66 % of six subjects felt it close to a direct touch."""


class Mean(NamedTuple):
    """A mean, and the 95 % percentile interval of its bootstrap."""

    value: float
    low: float
    high: float


def mean_of(values: Sequence[float]) -> Mean:
    """Return the mean of at least one value; the same values give the same interval."""
    drawn = np.random.default_rng(0).choice(np.asarray(values), (10_000, len(values)))
    low, high = np.quantile(drawn.mean(axis=1), (LEVEL / 2, 1 - LEVEL / 2))
    return Mean(float(np.mean(values)), float(low), float(high))


def hits_needed(trials: int) -> int:
    """Return the fewest hits with p ≤ 5 % by guessing; trials + 1 if no number suffices."""
    return int(binom.isf(LEVEL, trials, CHANCE)) + 1


def power(trials: int, share: float) -> float:
    """Return the probability of a result beyond guessing (p ≤ 5 %) with a true share of hits."""
    return float(binom.sf(hits_needed(trials) - 1, trials, share))


def trials_needed(share: float, wanted_power: float) -> int | None:
    """Return the number of trials from which on the power suffices; None if above 5000."""
    trials = np.arange(1, MOST_TRIALS + 1)
    hits = binom.isf(LEVEL, trials, CHANCE)
    short = np.flatnonzero(binom.sf(hits, trials, share) < wanted_power)
    needed = 1 if not len(short) else int(trials[short[-1]]) + 1
    return needed if needed <= MOST_TRIALS else None


class IntervalErrors(NamedTuple):
    """Force errors of a trial's intervals, in one unit."""

    a: float
    b: float
    x: float


def probability_of_a(errors: IntervalErrors, threshold: float | Floats) -> Floats:
    """Return the probability that X is identified as A.

    |x − a| < |x − b| where a − b and x − (a + b)/2 have the same sign. With noise of variance 1
    these two are independent, with variances 2 and 3/2.
    """
    apart = (errors.a - errors.b) / np.asarray(threshold) / math.sqrt(2)
    aside = (errors.x - (errors.a + errors.b) / 2) / np.asarray(threshold) / math.sqrt(1.5)
    return np.asarray(ndtr(apart) * ndtr(aside) + ndtr(-apart) * ndtr(-aside))


def proportion_correct(d_prime: float) -> float:
    """Return the share of correct answers of ABX for a d' between A and B."""
    return float(probability_of_a(IntervalErrors(d_prime, 0.0, d_prime), 1.0))


def d_prime(share: float) -> float:
    """Return the d' of a share of correct answers; 0 at a half and below, infinite at 1."""
    if share <= 0.5:
        return 0.0
    if share >= proportion_correct(MAX_D_PRIME):
        return math.inf
    return float(brentq(lambda d: proportion_correct(d) - share, 0.0, MAX_D_PRIME))


class Threshold(NamedTuple):
    """The error at which d' is 1, with its 95 % profile likelihood interval.

    low is 0, or high infinite, if the answers do not bound the threshold on that side.
    """

    value: float
    low: float
    high: float


def fit_threshold(trials: Sequence[tuple[IntervalErrors, bool]]) -> Threshold | None:
    """Return the maximum likelihood threshold of trials: their errors, and whether A was answered.

    None if the answers bound it on neither side, as with few answers or with guessing.
    """
    largest = max((abs(errors.a - errors.b) for errors, _ in trials), default=0.0)
    if largest == 0:
        return None
    tried = largest * np.logspace(-THRESHOLD_DECADES, THRESHOLD_DECADES, THRESHOLD_STEPS)
    likelihood = np.zeros(THRESHOLD_STEPS)
    for errors, called_a in trials:
        chance = probability_of_a(errors, tried)
        likelihood += np.log(np.maximum(chance if called_a else 1 - chance, 1e-300))
    best = int(np.argmax(likelihood))
    within = np.flatnonzero(likelihood > likelihood[best] - LOG_LIKELIHOOD_DROP)
    low = 0.0 if within[0] == 0 else float(tried[within[0]])
    high = math.inf if within[-1] == THRESHOLD_STEPS - 1 else float(tried[within[-1]])
    return None if low == 0 and high == math.inf else Threshold(float(tried[best]), low, high)


class SimulatedObserver:
    """Observer that answers by the differencing strategy.

    threshold: the difference in force error whose d' is 1, as a share of the pulse from peak to
    peak. Errors have the same unit. They are the aligned ones, because a finger alone cannot detect
    a delay.
    """

    def __init__(self, threshold: float, seed: int) -> None:
        self._threshold = threshold
        self._random = Random(f"observer {seed}")

    def identify(self, errors: IntervalErrors) -> str:
        """Return "A" or "B" for X."""
        a, b, x = map(self._feel, errors)
        return "A" if abs(x - a) < abs(x - b) else "B"

    def rate(self, reference: float, x: float) -> int:
        """Return the rating of X: 5 within 1 threshold of the reference, 4 within 2, down to 1."""
        return max(1, 5 - int(abs(self._feel(x) - self._feel(reference))))

    def _feel(self, error: float) -> float:
        return error / self._threshold + self._random.gauss(0, 1)


def percent(share: float) -> str:
    """Return a share as text."""
    return f"{100 * share:.3g} %"


def build_plan() -> Report:
    """Return the tables of trials and power, from exact binomial sums."""

    def needed(share: float, wanted_power: float) -> str:
        trials = trials_needed(share, wanted_power)
        return "more than 5000" if trials is None else str(trials)

    shares = [
        {
            "right": percent(share),
            "d'": f"{d_prime(share):.2f}",
            "4 times of 5": needed(share, 0.8),
            "9 times of 10": needed(share, 0.9),
        }
        for share in (0.55, 0.6, 2 / 3, 0.75, 0.8, 0.9, 0.95)
    ]
    counts = [
        {
            "trials": str(trials),
            "right for p ≤ 5 %": str(hits) if (hits := hits_needed(trials)) <= trials else "none",
            "passes at 2/3": percent(power(trials, PAPER.share)),
            "at 3/4": percent(power(trials, 0.75)),
            "at 9/10": percent(power(trials, 0.9)),
        }
        for trials in (6, 10, 16, 20, 32, 50, 100)
    ]
    tables = (
        Table.of(
            "Trials for a result beyond guessing, p ≤ 5 %",
            shares,
            "ABX, one-sided exact binomial test; no larger number of trials has less power.",
        ),
        Table.of(
            "What a number of trials can show",
            counts,
            "Probability of passing with a true share of right answers. The paper had six.",
        ),
    )
    return Report("How many trials", (Chapter("Trials", tables=tables),))
