"""Proportions with exact intervals, mean ratings, and how many trials show what."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom, binomtest

CHANCE = 0.5
LEVEL = 0.05
MOST_TRIALS = 5_000
RESAMPLED = 10_000


@dataclass(frozen=True, slots=True)
class Proportion:
    """So many of so many."""

    hits: int
    of: int

    @property
    def share(self) -> float:
        """Between 0 and 1."""
        return self.hits / self.of

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper and Pearson's, 95 %: holds the true share at least so often."""
        found = binomtest(self.hits, self.of).proportion_ci(1 - LEVEL, method="exact")
        return float(found.low), float(found.high)

    @property
    def p_value(self) -> float:
        """Probability of so many or more by guessing between two."""
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
    """Of one value or more; the same values give the same interval."""
    drawn = np.random.default_rng(0).choice(np.asarray(values), (RESAMPLED, len(values)))
    low, high = np.quantile(drawn.mean(axis=1), (LEVEL / 2, 1 - LEVEL / 2))
    return Mean(float(np.mean(values)), float(low), float(high))


def hits_needed(trials: int) -> int:
    """The least number of right answers that is beyond guessing, p ≤ 5 %; trials + 1: none is."""
    return int(binom.isf(LEVEL, trials, CHANCE)) + 1


def power(trials: int, share: float) -> float:
    """How often somebody who is right so often passes for more than guessing."""
    return float(binom.sf(hits_needed(trials) - 1, trials, share))


def trials_needed(share: float, wanted_power: float) -> int | None:
    """The number of trials from which on the power is never less; None: more than 5000."""
    trials = np.arange(1, MOST_TRIALS + 1)
    hits = binom.isf(LEVEL, trials, CHANCE)
    short = np.flatnonzero(binom.sf(hits, trials, share) < wanted_power)
    needed = 1 if not len(short) else int(trials[short[-1]]) + 1
    return needed if needed <= MOST_TRIALS else None
