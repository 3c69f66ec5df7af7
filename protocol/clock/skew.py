"""The skew of two clocks from messages that go one way, by how the level of their delay drifts.

One way tells nothing of the offset, and a way that becomes longer looks like skew; but a stream's
frames come more often than exchanges, and cost nothing. `protocol/clock/estimator.py` weighs both.
"""

import math

import numpy as np

from protocol.clock.offset_regression import Floats, fit_lines

BLOCK = 64
KEEP_BLOCKS = 256
STEADY_BLOCKS = 8
# Messages closer together wait for each other, and say little more than one of them.
APART_NS = 4_000_000
# A block's delay is the mean of so many of its shortest ones, by turns.
LEVELS = np.array([4, 8, 16, 32, BLOCK])
LEAST_NOISE_NS = 2_000.0
# Beyond this it is no clock.
MAX_SKEW = 0.01
# The shorter half of all blocks tells how much they scatter.
SHORT, HALF = 0.1, 0.5
# Neighbouring blocks meet the same spells, and are not as many as they seem.
ALIKE = 1.3


class OneWaySkew:
    """Pure: times come in with the messages.

    skew: remote over local clock, less 1; error: its standard error, infinite at first.
    """

    def __init__(self) -> None:
        self.skew, self.error = 0.0, math.inf
        self._first: tuple[int, int] | None = None
        self._last_sent_ns = 0
        # Since the first message: arrivals, and how much less a delay is than the first one.
        self._block: list[tuple[int, int]] = []
        self._t_ns = np.zeros(KEEP_BLOCKS)
        self._lead_ns = np.zeros((KEEP_BLOCKS, len(LEVELS)))
        self._known = 0

    def hear(self, sent_ns: int, arrived_ns: int, skew: float) -> None:
        """What was sent at a time of the remote clock has arrived at one of the local clock's.

        skew: of the clocks, as far as known, so that the order of delays is not that of times.
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
        """A line for each level; blocks of unusual delays weigh little."""
        t_ns, lead_ns = self._t_ns[: self._known], self._lead_ns[: self._known]
        late_ns = skew * (t_ns - t_ns[-1])[:, None] - lead_ns
        ordered_ns = np.sort(late_ns, axis=0)
        short_ns = ordered_ns[int(SHORT * self._known)]
        scatter_ns = LEAST_NOISE_NS + ordered_ns[int(HALF * self._known)] - short_ns
        weight = 1 / (1 + ((late_ns - short_ns) / (6 * scatter_ns)) ** 2)
        lines = fit_lines(t_ns, lead_ns, weight, scatter_ns, MAX_SKEW)
        error = ALIKE * lines.skew_error * (1 + 4 / self._known)
        error += _apart(lines.skew, error)
        level = int(np.argmin(error))
        self.skew, self.error = float(lines.skew[level]), float(error[level])


def _apart(skew: Floats, error: Floats) -> Floats:
    """By how much levels contradict that of the shortest delays: then load changed, not clocks."""
    apart: Floats = np.maximum(np.abs(skew - skew[0]) - 2 * np.hypot(error, error[0]), 0)
    return apart
