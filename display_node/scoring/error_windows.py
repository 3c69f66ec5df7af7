"""Errors and perceived delays by windows of time. Pure."""

import math

import numpy as np
from numpy.typing import NDArray

from protocol.summary.fields import AlignedErrors, ErrorWindow

# The first windows are of a second, while clock, buffer and predictor settle. Each further one is
# as long as all before it.
SINGLE_SECONDS = 15


class ErrorWindowCounter:
    """Counter of errors and perceived delays by windows of time."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._last_s = 0.0
        # By window, for E in ns and the squares of both errors: the sum and the number of ticks.
        self._sums: list[NDArray[np.float64]] = []

    def add(
        self,
        now_ns: NDArray[np.int64],
        delay_ns: NDArray[np.int64],
        aligned_n: NDArray[np.float64],
        in_phase_n: NDArray[np.float64],
    ) -> None:
        """Add consecutive ticks, each array of shape (n,). An unknown error is NaN."""
        if self._first_ns is None:
            self._first_ns = int(now_ns[0])
        values = np.array((delay_ns, aligned_n**2, in_phase_n**2), np.float64)
        since_ns = now_ns - self._first_ns
        while len(since_ns):
            # A step of the clock may lead back before the first tick.
            window = _window_at(max(int(since_ns[0]), 0) * 1e-9)
            end_ns = round(_window_begins_s(window + 1) * 1e9)
            ticks = max(1, int(np.searchsorted(since_ns, end_ns)))
            self._add_to(window, values[:, :ticks])
            self._last_s = max(self._last_s, int(since_ns[ticks - 1]) * 1e-9)
            since_ns, values = since_ns[ticks:], values[:, ticks:]

    def _add_to(self, window: int, values: NDArray[np.float64]) -> None:
        while len(self._sums) <= window:
            self._sums.append(np.zeros((3, 2)))
        known = np.isfinite(values)
        # `cumsum` adds one value after the other, at any count of ticks.
        self._sums[window][:, 0] += np.where(known, values, 0.0).cumsum(axis=1)[:, -1]
        self._sums[window][:, 1] += known.sum(axis=1)

    @property
    def judged_ticks(self) -> int:
        """Number of ticks whose aligned error is known."""
        return int(self._total[1, 1])

    @property
    def force_rmse_n(self) -> AlignedErrors:
        """RMSE over all windows, in N."""
        _, *errors = self._total.tolist()
        return AlignedErrors(*(_root(total, count) for total, count in errors))

    @property
    def _total(self) -> NDArray[np.float64]:
        """Sums and numbers of ticks, over all windows."""
        return np.asarray(np.sum([np.zeros((3, 2)), *self._sums], axis=0))

    def windows(self) -> list[ErrorWindow]:
        """Return the windows in which ticks were added."""
        found = []
        for number, sums in enumerate(self._sums):
            (delay_ns, ticks), *errors = sums.tolist()
            if ticks:
                to_s = min(_window_begins_s(number + 1), self._last_s)
                delay_ms = delay_ns / ticks * 1e-6
                rmse_n = (_root(total, count) for total, count in errors)
                found.append(ErrorWindow(_window_begins_s(number), to_s, delay_ms, *rmse_n))
        return found


def _root(total: float, count: float) -> float | None:
    return math.sqrt(total / count) if count else None


def _window_at(since_s: float) -> int:
    if since_s < SINGLE_SECONDS:
        return int(since_s)
    return SINGLE_SECONDS + int(math.log2(since_s / SINGLE_SECONDS))


def _window_begins_s(number: int) -> float:
    return float(min(number, SINGLE_SECONDS) << max(number - SINGLE_SECONDS, 0))
