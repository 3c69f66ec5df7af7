"""Statistics of blinded trials: proportions, the differencing observer, the number of trials.

The observer's percept of an interval is one number: its force error in units of the threshold,
with noise of deviation 1. X is identified as the nearer one of A and B. This is the differencing
strategy of Macmillan and Creelman, *Detection Theory*, ch. 9. At the threshold d' is 1.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from random import Random
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import ndtr
from scipy.stats import binom, binomtest

from telepulse.reports.document import Chapter, Report, Table

CHANCE = 0.5
LEVEL = 0.05
MOST_TRIALS = 5_000
RESAMPLED = 10_000
Floats = NDArray[np.float64]
MAX_D_PRIME = 20.0
THRESHOLD_STEPS = 4_000
THRESHOLD_DECADES = 3
# Half of the 95 % point of chi square with one degree of freedom.
LOG_LIKELIHOOD_DROP = 1.920729
BEST_RATING = 5
SHARES = (0.55, 0.6, 2 / 3, 0.75, 0.8, 0.9, 0.95)
COUNTS = (6, 10, 16, 20, 32, 50, 100)
POWERS = (0.8, 0.9)


@dataclass(frozen=True, slots=True)
class Proportion:
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


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean, and the 95 % percentile interval of its bootstrap."""

    value: float
    low: float
    high: float


def mean_of(values: Sequence[float]) -> Mean:
    """Return the mean of one value or more; the same values give the same interval."""
    drawn = np.random.default_rng(0).choice(np.asarray(values), (RESAMPLED, len(values)))
    low, high = np.quantile(drawn.mean(axis=1), (LEVEL / 2, 1 - LEVEL / 2))
    return Mean(float(np.mean(values)), float(low), float(high))


def hits_needed(trials: int) -> int:
    """Return the least hits that are beyond guessing, p ≤ 5 %; trials + 1 where none are."""
    return int(binom.isf(LEVEL, trials, CHANCE)) + 1


def power(trials: int, share: float) -> float:
    """Return the probability of passing for more than guessing with a true share of hits."""
    return float(binom.sf(hits_needed(trials) - 1, trials, share))


def trials_needed(share: float, wanted_power: float) -> int | None:
    """Return the number of trials from which on the power is never less; None: above 5000."""
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

    |x − a| < |x − b| where a − b and x − (a + b)/2 have the same sign; with noise of deviation 1
    they are independent, of variances 2 and 3/2.
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


@dataclass(frozen=True, slots=True)
class Threshold:
    """The error at which d' is 1, with its 95 % profile likelihood interval.

    low and high are 0 and infinity where the answers set no bound.
    """

    value: float
    low: float
    high: float


def fit_threshold(trials: Sequence[tuple[IntervalErrors, bool]]) -> Threshold | None:
    """Return the maximum likelihood threshold of trials: their errors, and whether X was A.

    None where the answers set no bound on either side, as for few answers or guesses.
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
    """Answers by the differencing strategy.

    threshold: the difference in force error whose d' is 1, as a share of the pulse from peak to
    peak. Errors have the same unit and are aligned: a finger alone cannot detect a delay.
    """

    def __init__(self, threshold: float, seed: int) -> None:
        self._threshold = threshold
        self._random = Random(f"observer {seed}")

    def identify(self, errors: IntervalErrors) -> str:
        """Return "A" or "B" for X."""
        a, b, x = map(self._feel, errors)
        return "A" if abs(x - a) < abs(x - b) else "B"

    def rate(self, reference: float, x: float) -> int:
        """Return the rating of X: 5 within one threshold of the reference, 4 within two, to 1."""
        return max(1, BEST_RATING - int(abs(self._feel(x) - self._feel(reference))))

    def _feel(self, error: float) -> float:
        return error / self._threshold + self._random.gauss(0, 1)


def build_plan() -> Report:
    """Return the tables of trials and power, from exact binomial sums."""
    return Report("How many trials", (Chapter("Trials", (), (_needed(), _counts())),))


def percent(share: float) -> str:
    """Return a share as text."""
    return f"{100 * share:.3g} %"


def _needed() -> Table:
    rows = tuple(
        (
            percent(share),
            f"{d_prime(share):.2f}",
            *(_or_more(trials_needed(share, wanted)) for wanted in POWERS),
        )
        for share in SHARES
    )
    return Table(
        "Trials that a subject needs to pass for more than guessing, p ≤ 5 %",
        ("right", "d'", "4 times of 5", "9 times of 10"),
        rows,
        "ABX, one-sided exact binomial test; with more trials the power is never lower.",
    )


def _or_more(trials: int | None) -> str:
    return "more than 5000" if trials is None else str(trials)


def _counts() -> Table:
    rows = tuple(
        (
            str(trials),
            f"{hits_needed(trials)}" if hits_needed(trials) <= trials else "none",
            *(percent(power(trials, share)) for share in (PAPER.share, 0.75, 0.9)),
        )
        for trials in COUNTS
    )
    return Table(
        "What a number of trials can show",
        ("trials", "right for p ≤ 5 %", "passes at 2/3", "at 3/4", "at 9/10"),
        rows,
        "Probability of passing with a true share of right answers. The paper had six.",
    )
