"""Skew of two clocks from one-way messages, by the drift of their apparent delay.

One direction gives no offset, and a delay that grows looks like skew. But a stream's frames come
more often than exchanges, at no cost. `ClockEstimator` weighs both.
"""

import math

import numpy as np

from protocol.clock.offset_regression import Floats, fit_lines

BLOCK = 64
KEEP_BLOCKS = 256
STEADY_BLOCKS = 8
# Messages closer together delay each other, and add little to one of them.
APART_NS = 4_000_000
# Numbers of shortest delays whose mean is a block's delay.
LEVELS = np.array([4, 8, 16, 32, BLOCK])
LEAST_NOISE_NS = 2_000.0
# No clock is worse.
MAX_SKEW = 0.01
# Quantiles of the blocks' delays: reference, and scatter above it.
SHORT, HALF = 0.1, 0.5
# Factor on errors: neighbouring blocks are correlated, so fewer than their number count.
CORRELATION = 1.3


class OneWaySkew:
    """Estimator of skew from one-way messages. Pure: all times are arguments, in integer ns.

    Attributes
    ----------
    skew : float
        Remote over local clock rate, less 1.
    error : float
        Its standard error, infinite at first.
    """

    def __init__(self) -> None:
        self.skew, self.error = 0.0, math.inf
        self._first: tuple[int, int] | None = None
        self._last_sent_ns = 0
        # Since the first message: arrival, and by how much the delay is less than the first one.
        self._block: list[tuple[int, int]] = []
        self._t_ns = np.zeros(KEEP_BLOCKS)
        self._lead_ns = np.zeros((KEEP_BLOCKS, len(LEVELS)))
        self._known = 0

    def add(self, sent_ns: int, arrived_ns: int, skew: float) -> None:
        """Add a message.

        Parameters
        ----------
        sent_ns : int
            When it was sent, remote clock.
        arrived_ns : int
            When it arrived, local clock.
        skew : float
            Present estimate, removed from the delays so that they can be ordered.
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
        error += _bias(lines.skew, error)
        level = int(np.argmin(error))
        self.skew, self.error = float(lines.skew[level]), float(error[level])


def _bias(skew: Floats, error: Floats) -> Floats:
    """Return each level's contradiction to the shortest delays, which shows a change of load."""
    bias: Floats = np.maximum(np.abs(skew - skew[0]) - 2 * np.hypot(error, error[0]), 0)
    return bias
