"""Sums of errors and perceived delays, over a run and by windows of time. Pure."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from protocol.summary.fields import ErrorWindow, RmsErrors

# The first windows are of a second, while clock, buffer and predictor settle. Each further one is
# as long as all before it.
SINGLE_SECONDS = 15


def rms(errors: NDArray[np.float64]) -> float | None:
    """Return the root mean square of the errors that are known; None without any."""
    known = errors[~np.isnan(errors)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else None


@dataclass(slots=True)
class KnownSum:
    """Sum and number of the values that are known."""

    total: float = 0.0
    count: int = 0

    def add(self, values: NDArray[np.float64]) -> None:
        """Add values; NaN is unknown."""
        known = values[np.isfinite(values)]
        if len(known):
            # `cumsum` adds one value after the other, at any count of ticks.
            self.total += float(known.cumsum()[-1])
            self.count += len(known)

    @property
    def root_mean(self) -> float | None:
        """Root of the mean; None without a known value."""
        return math.sqrt(self.total / self.count) if self.count else None


@dataclass(slots=True)
class WindowSums:
    """Sums over the ticks of a window: of E in ns, and of the squares of both errors in N²."""

    delay_ns: KnownSum = field(default_factory=KnownSum)
    aligned: KnownSum = field(default_factory=KnownSum)
    in_phase: KnownSum = field(default_factory=KnownSum)


class ErrorSums:
    """Sums of both errors and of the perceived delay over a run, kept by windows of time."""

    def __init__(self) -> None:
        self._first_ns: int | None = None
        self._last_s = 0.0
        self._windows: list[WindowSums] = []

    def add(
        self,
        now_ns: NDArray[np.int64],
        delay_ns: NDArray[np.int64],
        aligned_n: NDArray[np.float64],
        in_phase_n: NDArray[np.float64],
    ) -> None:
        """Add consecutive ticks, each array of shape (n,). An unknown error is NaN.

        now_ns: time on a clock that does not step; the first tick's begins the first window.
        """
        if self._first_ns is None:
            self._first_ns = int(now_ns[0])
        since_ns = now_ns - self._first_ns
        first = 0
        while first < len(since_ns):
            # A recording may have a display that was restarted on a host that was, too.
            window = _window_at(max(int(since_ns[first]), 0) * 1e-9)
            end_ns = round(_window_begins_s(window + 1) * 1e9)
            end = first + max(1, int(np.searchsorted(since_ns[first:], end_ns)))
            while len(self._windows) <= window:
                self._windows.append(WindowSums())
            sums, ticks = self._windows[window], slice(first, end)
            sums.delay_ns.add(delay_ns[ticks].astype(np.float64))
            sums.aligned.add(aligned_n[ticks] ** 2)
            sums.in_phase.add(in_phase_n[ticks] ** 2)
            self._last_s = max(self._last_s, int(since_ns[end - 1]) * 1e-9)
            first = end

    @property
    def judged_ticks(self) -> int:
        """Number of ticks whose aligned error is known."""
        return sum(each.aligned.count for each in self._windows)

    @property
    def force_rmse_n(self) -> RmsErrors:
        """RMSE over all windows, in N."""
        return RmsErrors(
            _whole([each.aligned for each in self._windows]).root_mean,
            _whole([each.in_phase for each in self._windows]).root_mean,
        )

    def windows(self) -> list[ErrorWindow]:
        """Return the windows in which ticks were added."""
        return [
            ErrorWindow(
                _window_begins_s(number),
                min(_window_begins_s(number + 1), self._last_s),
                sums.delay_ns.total / sums.delay_ns.count * 1e-6,
                sums.aligned.root_mean,
                sums.in_phase.root_mean,
            )
            for number, sums in enumerate(self._windows)
            if sums.delay_ns.count
        ]


def _whole(parts: list[KnownSum]) -> KnownSum:
    return KnownSum(sum(each.total for each in parts), sum(each.count for each in parts))


def _window_at(since_s: float) -> int:
    if since_s < SINGLE_SECONDS:
        return int(since_s)
    return SINGLE_SECONDS + int(math.log2(since_s / SINGLE_SECONDS))


def _window_begins_s(number: int) -> float:
    return float(min(number, SINGLE_SECONDS) << max(number - SINGLE_SECONDS, 0))
