"""Robust growth rate: the median of the slopes between all pairs of samples.

Theil (1950) and Sen (1968). A restarted process gives several series: pairs are made within each,
and Kendall's S is summed over them (Helsel and Frans 2006, the regional test). Its variance is
increased by the dependence of neighbouring samples (Yue and Wang 2004): a process's memory changes
slowly, so that a hundred samples of it may carry as much information as a few.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# From fewer samples, their dependence cannot be estimated.
MIN_SAMPLES = 30
Z_95 = 1.959964
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Slope:
    """A slope and its 95 % interval, per second."""

    median: float
    low: float
    high: float


def slope(lines: Sequence[tuple[Floats, Floats]]) -> Slope | None:
    """Return the common slope of series of times in s and values of equal length.

    None when no series is long enough.
    """
    slopes, variance = [], 0.0
    for times_s, values in lines:
        if len(times_s) < MIN_SAMPLES:
            continue
        first, second = np.triu_indices(len(times_s), 1)
        found = (values[second] - values[first]) / (times_s[second] - times_s[first])
        slopes.append(found)
        residuals = values - float(np.median(found)) * times_s
        variance += _variance_of_s(values) * _dependence(residuals)
    if not slopes:
        return None
    ordered = np.sort(np.concatenate(slopes))
    half = Z_95 * math.sqrt(variance) / 2
    middle = (len(ordered) - 1) / 2
    low, high = max(0, math.floor(middle - half)), min(len(ordered) - 1, math.ceil(middle + half))
    return Slope(float(np.median(ordered)), float(ordered[low]), float(ordered[high]))


def _variance_of_s(values: Floats) -> float:
    """Return the variance of S without a trend; equal values carry no information."""
    count = len(values)
    _, ties = np.unique(values, return_counts=True)
    tied = float(np.sum(ties * (ties - 1) * (2 * ties + 5)))
    return (count * (count - 1) * (2 * count + 5) - tied) / 18


def _dependence(residuals: Floats) -> float:
    """Return the number of samples with the information of one, by neighbours' correlation."""
    count = len(residuals)
    centred = residuals - residuals.mean()
    power = float(centred @ centred)
    if power == 0.0:
        return 1.0
    neighbours = max(0.0, float(centred[1:] @ centred[:-1]) / power)
    lags = np.arange(1, count)
    return 1.0 + 2.0 * float(np.sum((1 - lags / count) * neighbours**lags))
