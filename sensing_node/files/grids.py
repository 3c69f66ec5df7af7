"""Samples at a constant rate, from values with times; NaN in gaps, which are counted or filled."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.config.quantities import count_text
from protocol.errors import SourceError
from sensing_node.files.bounds import check_samples
from sensing_node.files.recording_plausibility import GAP_STEPS, blocks
from sensing_node.files.signals import Floats

# Largest share of a signal that gaps may be: times beyond it are damaged.
MOST_GAPS = 20
# Samples of a gap that any signal may have.
FREE_GAP = 200_000


def on_grid(t_s: Floats, values: Floats, rate_hz: float, path: Path) -> Floats:
    """Return values, each with an ascending time, at a constant rate; NaN where no time is near.

    Raises SourceError if times fall, or gaps are longer than `MOST_GAPS` times the signal.
    """
    falls = np.flatnonzero(~(np.diff(t_s) >= 0))
    if len(falls) or not np.all(np.isfinite(t_s)):
        at = int(falls[0]) + 1 if len(falls) else 0
        raise SourceError(f"{path}: the times fall at sample {at}; sort or repair the file")
    places = (t_s - t_s[0]) * rate_hz if len(t_s) else t_s
    if len(t_s) and places[-1] > MOST_GAPS * len(t_s) + FREE_GAP:
        raise SourceError(
            f"{path}: {count_text(len(t_s), 'sample')} at {rate_hz:g} Hz extend over"
            f" {t_s[-1] - t_s[0]:.4g} s; its times are damaged"
        )
    numbers = np.rint(places).astype(np.int64)
    check_samples(path, int(numbers[-1]) + 1 if len(numbers) else 0)
    grid = np.full(int(numbers[-1]) + 1 if len(numbers) else 0, np.nan)
    grid[numbers] = values
    return grid


def evenly(
    t_s: Floats, values: Floats, path: Path, rate_hz: float | None = None
) -> tuple[float, Floats]:
    """Return the rate in Hz of time-stamped values, and the values at that rate.

    Values whose times are even within half a sample are returned as they are; others are
    interpolated linearly, with NaN in gaps longer than `GAP_STEPS` usual steps. rate_hz: where it
    is known. Raises SourceError if times fall, do not differ, or extend too far.
    """
    if len(t_s) == 1 and rate_hz:
        return rate_hz, values
    steps = np.diff(t_s)
    rises = steps[steps > 0]
    if not len(rises):
        raise SourceError(f"{path}: its times do not rise")
    usual = float(np.median(rises))
    # Further digits are rounding, and a signal of 250.00000000000003 Hz would be interpolated.
    rate_hz = rate_hz or float(f"{1 / steps[steps <= GAP_STEPS * usual].mean():.12g}")
    count = round(float(t_s[-1] - t_s[0]) * rate_hz) + 1 if np.all(np.isfinite(t_s)) else 0
    if count == len(t_s):
        at_s = t_s[0] + np.arange(count) / rate_hz
        if float(np.abs(t_s - at_s).max()) < 0.5 / rate_hz:
            return rate_hz, values
    # Checks the times, too.
    length = len(on_grid(t_s, values, rate_hz, path))
    at_s = t_s[0] + np.arange(length) / rate_hz
    after = np.clip(np.searchsorted(t_s, at_s), 1, len(t_s) - 1)
    even: Floats = np.interp(at_s, t_s, values)
    near_s = np.minimum(np.abs(t_s[after] - at_s), np.abs(at_s - t_s[after - 1]))
    apart = (steps[after - 1] > GAP_STEPS * usual) & (near_s > 0.5 / rate_hz)
    even[apart] = np.nan
    return rate_hz, even


def unsteady(error: SourceError, path: Path) -> str:
    """Return the reason why a signal is left out whose times `evenly` refuses."""
    return f"has no steady rate: {str(error).removeprefix(f'{path}: ')}"


class Gaps(NamedTuple):
    """Missing samples of a signal: their number, that of runs of them, and the longest run."""

    samples: int
    runs: int
    longest: int

    def text(self, length: int, rate_hz: float) -> str:
        """Return the gaps of a signal of some length, for people."""
        return (
            f"{count_text(self.samples, 'sample is', 'samples are')} missing"
            f" ({100 * self.samples / length:.2g} %) in {count_text(self.runs, 'gap')}, the longest"
            f" of {self.longest / rate_hz:.3g} s"
        )


def find_gaps(values: NDArray[Any]) -> Gaps:
    """Count the NaN of a signal."""
    if not any(np.isnan(block).any() for block in blocks(values)):
        return Gaps(0, 0, 0)
    edges = _edges(np.isnan(values))
    lengths = edges[1::2] - edges[::2]
    return Gaps(int(lengths.sum()), len(lengths), int(lengths.max(initial=0)))


def fill_gaps(values: NDArray[Any]) -> NDArray[Any]:
    """Return a signal with straight lines through its gaps; it must have a value."""
    missing = np.isnan(values)
    if not missing.any():
        return values
    edges, at = _edges(missing), np.flatnonzero(missing)
    # Of the samples, only those beside gaps are needed.
    beside = np.union1d(edges[::2] - 1, edges[1::2])
    beside = beside[(beside >= 0) & (beside < len(values))]
    filled = np.array(values)
    filled[at] = np.interp(at, beside, values[beside])
    return filled


def _edges(missing: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the first sample of each gap, and the first one after it, in turn."""
    return np.flatnonzero(np.diff(missing, prepend=False, append=False))
