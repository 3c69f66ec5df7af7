"""A straight line through reference loads by least squares, and what is left over. Pure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.errors import BenchError

Array = NDArray[np.float64]
LEAST_LOADS = 3


@dataclass(frozen=True, slots=True)
class CalibrationLine:
    """reading = slope · load + offset; readings in their own unit, loads in N.

    slope_error, offset_error: standard errors. residual_n: what each reading is off the line,
    as a force, in the order of the loads. hysteresis_n: the largest difference of the means of
    rising and falling loads, at loads that came both ways. repeatability_n: standard deviation
    of readings at the same load, reached the same way. Both None where no load tells.
    """

    slope: float
    offset: float
    slope_error: float
    offset_error: float
    r_squared: float
    residual_n: Array
    hysteresis_n: float | None
    repeatability_n: float | None

    @property
    def rms_n(self) -> float:
        """RMS of what is off the line, for the two degrees of freedom that the line takes."""
        return float(np.sqrt(np.sum(self.residual_n**2) / (len(self.residual_n) - 2)))

    @property
    def largest_n(self) -> float:
        """The reading that is furthest off the line."""
        return float(np.max(np.abs(self.residual_n)))


def fit_line(load_n: Array, reading: Array) -> CalibrationLine:
    """The line through loads, in the order in which they were put on, shape (n,) each.

    Raises BenchError for fewer than 3 loads, for equal loads, and for readings that do not
    change with them.
    """
    count = len(load_n)
    if count < LEAST_LOADS:
        raise BenchError(f"{count} loads; at least {LEAST_LOADS} are needed for a line")
    if not np.ptp(load_n):
        raise BenchError(f"all loads are {load_n[0]:g} N; different ones are needed for a line")
    around_n = load_n - load_n.mean()
    power = float(around_n @ around_n)
    slope = float(around_n @ reading) / power
    offset = float(reading.mean() - slope * load_n.mean())
    if not np.ptp(reading) or not slope:
        raise BenchError("the readings do not change with the loads")
    off = reading - slope * load_n - offset
    spread = float(np.sqrt(off @ off / (count - 2)))
    return CalibrationLine(
        slope=slope,
        offset=offset,
        slope_error=spread / power**0.5,
        offset_error=spread * float(np.sqrt(1 / count + load_n.mean() ** 2 / power)),
        r_squared=1 - float(off @ off) / float(np.sum((reading - reading.mean()) ** 2)),
        residual_n=off / slope,
        hysteresis_n=_hysteresis_n(load_n, off / slope),
        repeatability_n=_repeatability_n(load_n, off / slope),
    )


def _ways(load_n: Array) -> NDArray[np.bool_]:
    """Whether each load was reached from below. The first one was, from none; a load put on
    again goes on the way it came."""
    rising, ways = True, []
    for before, after in zip([0.0, *load_n[:-1].tolist()], load_n.tolist(), strict=True):
        if after != before:
            rising = after > before
        ways.append(rising)
    return np.array(ways)


def _hysteresis_n(load_n: Array, off_n: Array) -> float | None:
    rising = _ways(load_n)
    gaps_n = [
        abs(float(off_n[same & rising].mean() - off_n[same & ~rising].mean()))
        for same in (load_n == load for load in np.unique(load_n))
        if (same & rising).any() and (same & ~rising).any()
    ]
    return max(gaps_n, default=None)


def _repeatability_n(load_n: Array, off_n: Array) -> float | None:
    """Pooled over all loads."""
    groups = np.unique(np.stack([load_n, _ways(load_n)]), axis=1, return_inverse=True)[1].ravel()
    count = np.bincount(groups)
    freedom = int(np.sum(count - 1))
    if not freedom:
        return None
    means_n = np.bincount(groups, off_n) / count
    return float(np.sqrt(np.sum((off_n - means_n[groups]) ** 2) / freedom))
