"""Clocks from one-way messages: their skew, and the clock of a device that answers no requests.

One direction gives no offset, and a growing delay looks like skew. But a stream's frames come more
often than exchanges, at no cost. `ClockEstimator` weighs both.
"""

import math
from collections import deque
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# Weight of the expected noise, as a number of points.
NOISE_POINTS: Final = 4.0


class OffsetRegression(NamedTuple):
    """Lines offset(t) = offset_ns + skew (t - middle_ns), with their standard errors.

    Each array has shape (lines,); middle_ns is the weighted mean of the points' times.
    """

    middle_ns: Floats
    offset_ns: Floats
    skew: Floats
    offset_error_ns: Floats
    skew_error: Floats

    def at(self, t_ns: float) -> Floats:
        """Return the offsets at a time, in ns."""
        offset_ns: Floats = self.offset_ns + self.skew * (t_ns - self.middle_ns)
        return offset_ns

    def error_at(self, t_ns: float) -> Floats:
        """Return the standard errors of the offsets at a time, in ns."""
        error_ns: Floats = np.hypot(self.offset_error_ns, self.skew_error * (t_ns - self.middle_ns))
        return error_ns


def fit_lines(
    t_ns: Floats, offset_ns: Floats, weight: Floats, noise_ns: Floats | float, usual_skew: float
) -> OffsetRegression:
    """Fit lines through weighted points, with prior knowledge of noise and skew.

    The priors bound the slope and the standard errors where there are few points.

    Parameters
    ----------
    t_ns : ndarray, shape (points,)
        Times.
    offset_ns, weight : ndarray, shape (points, lines)
        Offsets and their weights; the best points have 1.
    noise_ns : ndarray, shape (lines,), or float
        Expected standard deviation of a point of weight 1.
    usual_skew : float
        Expected standard deviation of clocks' skews.
    """
    # Relative to one of the points, so that the sums of squares lose no digits.
    about_ns, zero_ns = t_ns[len(t_ns) // 2], offset_ns[-1]
    x_ns, y_ns = t_ns - about_ns, offset_ns - zero_ns
    powers = np.array((np.ones(len(t_ns)), x_ns, x_ns * x_ns))
    weighted_ns = weight * y_ns
    total, x_sum, xx_sum = powers @ weight
    y_sum, xy_sum = powers[:2] @ weighted_ns
    x_mean, y_mean = x_sum / total, y_sum / total
    spread, slope = xx_sum - x_mean * x_sum, xy_sum - x_mean * y_sum
    # The unconstrained line's residuals give the noise, and the noise the weight of the usual skew.
    squares = np.einsum("ij,ij->j", weighted_ns, y_ns) - y_mean * y_sum
    squares -= slope * slope / np.maximum(spread, 1.0)
    # Where a line fits exactly, rounding may leave less than 0.
    variance = np.maximum(squares, 0) + NOISE_POINTS * np.square(noise_ns)
    variance /= np.maximum(total - 2, 0) + NOISE_POINTS
    information = spread + variance / usual_skew**2
    middle_ns, mean_ns = about_ns + x_mean, zero_ns + y_mean
    return OffsetRegression(
        middle_ns,
        mean_ns,
        slope / information,
        np.sqrt(variance / total),
        np.sqrt(variance / information),
    )


def contradiction(values: Floats, errors: Floats) -> Floats:
    """Return how far each value differs from the first, beyond two standard errors of both."""
    apart: Floats = np.abs(values - values[0]) - 2 * np.hypot(errors, errors[0])
    return np.maximum(apart, 0)


BLOCK: Final = 64
KEEP_BLOCKS: Final = 256
STEADY_BLOCKS: Final = 8
# Least time between two messages that are used: closer ones delay each other.
APART_NS: Final = 4_000_000
# Numbers of shortest delays whose mean is a block's delay.
LEVELS = np.array([4, 8, 16, 32, BLOCK])
LEAST_NOISE_NS: Final = 2_000.0
# Upper bound of any clock's skew.
MAX_SKEW: Final = 0.01
# Quantiles of the blocks' delays: reference, and scatter above it.
SHORT, HALF = 0.1, 0.5
# Factor on errors, because neighbouring blocks are correlated.
CORRELATION: Final = 1.3


class OneWaySkew:
    """Estimator of skew from one-way messages. Pure: all times are arguments, in integer ns.

    skew: remote over local clock rate, less 1. error: its standard error, infinite at first.
    """

    def __init__(self) -> None:
        self.skew, self.error = 0.0, math.inf
        self._first: tuple[int, int] | None = None
        self._last_sent_ns = 0
        # Arrival and decrease of the delay, both relative to the first message.
        self._block: list[tuple[int, int]] = []
        self._t_ns = np.zeros(KEEP_BLOCKS)
        self._lead_ns = np.zeros((KEEP_BLOCKS, len(LEVELS)))
        self._known = 0

    def add(self, sent_ns: int, arrived_ns: int, skew: float) -> None:
        """Add a message by its times of sending (remote clock) and arrival (local clock).

        skew: present estimate, removed from the delays so that they can be ordered.
        """
        if self._first is None:
            self._first = sent_ns, arrived_ns
        elif sent_ns - self._last_sent_ns < APART_NS:
            return
        self._last_sent_ns = sent_ns
        since_ns = arrived_ns - self._first[1]
        self._block.append((since_ns, sent_ns - self._first[0] - since_ns))
        if len(self._block) == BLOCK:
            self._close_block(skew)
            if self._known >= STEADY_BLOCKS:
                self._fit(skew)

    def _close_block(self, skew: float) -> None:
        if self._known == KEEP_BLOCKS:
            self._t_ns[:-1], self._lead_ns[:-1] = self._t_ns[1:], self._lead_ns[1:]
            self._known -= 1
        since_ns, lead_ns = np.array(self._block, dtype=float).T
        middle_ns = since_ns.sum() / BLOCK
        late_ns = np.sort(skew * (since_ns - middle_ns) - lead_ns)
        self._t_ns[self._known] = middle_ns
        self._lead_ns[self._known] = -late_ns.cumsum()[LEVELS - 1] / LEVELS
        self._known += 1
        self._block = []

    def _fit(self, skew: float) -> None:
        """Fit a line for each level, with low weights for unusual delays; select the best."""
        t_ns, lead_ns = self._t_ns[: self._known], self._lead_ns[: self._known]
        late_ns = skew * (t_ns - t_ns[-1])[:, None] - lead_ns
        ordered_ns = np.sort(late_ns, axis=0)
        short_ns = ordered_ns[int(SHORT * self._known)]
        scatter_ns = LEAST_NOISE_NS + ordered_ns[int(HALF * self._known)] - short_ns
        weight = 1 / (1 + ((late_ns - short_ns) / (6 * scatter_ns)) ** 2)
        lines = fit_lines(t_ns, lead_ns, weight, scatter_ns, MAX_SKEW)
        error = CORRELATION * lines.skew_error * (1 + 4 / self._known)
        # A contradiction to the shortest delays shows a change of the network's load.
        error += contradiction(lines.skew, error)
        level = int(np.argmin(error))
        self.skew, self.error = float(lines.skew[level]), float(error[level])


BLOCK_NS: Final = 250_000_000
KEEP: Final = 256
READY_AFTER: Final = 2
# Resonators of boards without a crystal are off by up to 0.5 %.
DEVICE_SKEW: Final = 2e-3
DEVICE_NOISE_NS: Final = 20_000.0
# An arrival this long before its timestamp, STEP_AFTER times in a row, is a step of the clock.
STEP_MARGIN_NS: Final = 20_000_000
STEP_AFTER: Final = 3
# A delay above this in this number of consecutive blocks is a step too; no cable is so slow.
LATE_NS: Final = 500_000_000
LATE_BLOCKS: Final = 4
ROUNDS: Final = 3


class DeviceClock:
    """Estimator of a device's clock from its timestamps and their arrivals, in integer ns. Pure.

    The device answers no requests. Its samples arrive late and in batches, never early. So arrival
    minus device time has a lower edge, and the clock is a line along that edge. The smallest delay
    cannot be separated from the clock's offset; it remains in the returned times.
    steps: number of steps or restarts of the device's clock; each starts the estimate again.
    """

    def __init__(self) -> None:
        self.steps = 0
        self._last_device_ns: int | None = None
        self._base_device_ns = self._base_offset_ns = 0
        self._reference_ns = self._offset_ns = 0
        self._skew = 0.0
        # The earliest arrival of each block: device time, and arrival minus device time.
        self._edge: deque[tuple[float, float]] = deque(maxlen=KEEP)
        self._block_began_ns = self._least_late_ns = 0
        self._least = (0, 0)
        self._early = self._late_blocks = 0

    @property
    def ready(self) -> bool:
        """True after half a second, when times are accurate to the usual spread of the delays."""
        return len(self._edge) >= READY_AFTER

    @property
    def skew_ppm(self) -> float:
        """Device over host clock rate, less 1, in parts per million."""
        return (1 / (1 + self._skew) - 1) * 1e6

    def host_ns(self, device_ns: int) -> int:
        """Return the host's clock at a device time; before any observation, that time itself."""
        return device_ns + self._offset_ns + round(self._skew * (device_ns - self._reference_ns))

    def observe(self, device_ns: int, arrival_ns: int) -> None:
        """Add a timestamp of the device and its arrival; call this in the order of arrival.

        An arrival before its timestamp is not used; several in a row show a step of the device's
        clock. A timestamp before the last one shows a step at once.
        """
        if self._last_device_ns is None:
            self._anchor(device_ns, arrival_ns)
        elif device_ns < self._last_device_ns:
            self._step(device_ns, arrival_ns)
        elif self.ready and arrival_ns < self.host_ns(device_ns) - STEP_MARGIN_NS:
            self._early += 1
            if self._early < STEP_AFTER:
                return
            self._step(device_ns, arrival_ns)
        self._early = 0
        self._last_device_ns = device_ns
        late_ns = arrival_ns - self.host_ns(device_ns)
        if late_ns < self._least_late_ns:
            self._least_late_ns, self._least = late_ns, (device_ns, arrival_ns)
        if arrival_ns - self._block_began_ns >= BLOCK_NS:
            self._close_block(arrival_ns)

    def _step(self, device_ns: int, arrival_ns: int) -> None:
        self.steps += 1
        self._anchor(device_ns, arrival_ns)

    def _anchor(self, device_ns: int, arrival_ns: int) -> None:
        self._base_device_ns = self._reference_ns = self._last_device_ns = device_ns
        self._base_offset_ns = self._offset_ns = arrival_ns - device_ns
        self._skew = 0.0
        self._edge.clear()
        self._early = self._late_blocks = 0
        self._block_began_ns, self._least_late_ns = arrival_ns, 1 << 63

    def _close_block(self, now_ns: int) -> None:
        device_ns, arrival_ns = self._least
        late_ns = self._least_late_ns
        self._block_began_ns, self._least_late_ns = now_ns, 1 << 63
        self._late_blocks = self._late_blocks + 1 if self.ready and late_ns > LATE_NS else 0
        if self._late_blocks >= LATE_BLOCKS:
            self._step(device_ns, arrival_ns)
        # Differences are exact as floats, large times are not.
        since_ns = float(device_ns - self._base_device_ns)
        drift_ns = float(arrival_ns - device_ns - self._base_offset_ns)
        self._edge.append((since_ns, drift_ns))
        self._fit()

    def _fit(self) -> None:
        """Fit a line along the blocks' earliest arrivals, with low weights for late blocks."""
        since_ns, drift_ns = np.array(self._edge).T
        weight = np.ones((len(since_ns), 1))
        noise_ns = np.array([DEVICE_NOISE_NS])
        for _ in range(ROUNDS):
            line = fit_lines(since_ns, drift_ns[:, None], weight, noise_ns, DEVICE_SKEW)
            late_ns = drift_ns - line.offset_ns - line.skew * (since_ns - line.middle_ns)
            usual_ns = DEVICE_NOISE_NS + float(np.median(np.abs(late_ns)))
            weight = (1 / (1 + (np.maximum(late_ns, 0) / usual_ns) ** 2))[:, None]
        middle_ns = round(float(line.middle_ns[0]))
        self._reference_ns = self._base_device_ns + middle_ns
        self._offset_ns = self._base_offset_ns + round(float(line.at(middle_ns)[0]))
        self._skew = float(line.skew[0])
