"""Clock offset and skew between two hosts, from four-timestamp exchanges.

Offset is remote minus local. An exchange can be wrong by at most half its round trip, so the
shortest round trips tell most: the estimator draws a line through the last exchanges, each
weighted by how much longer it took than the best of them.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

KEEP = 256
READY_AFTER = 3
MIN_DOUBT_NS = 20_000
# Clocks of computers run alike to about this; what a few seconds seem to say beyond it is jitter.
USUAL_SKEW = 100e-6
# Beyond this it is no clock.
MAX_SKEW = 0.01
STEP_AFTER = 3
STEP_MARGIN_NS = 5_000_000


class ClockExchange(NamedTuple):
    """t1: request leaves (local clock); t2: it arrives, t3: reply leaves (remote clock);
    t4: reply arrives (local clock); all ns."""

    t1_ns: int
    t2_ns: int
    t3_ns: int
    t4_ns: int

    @property
    def offset_ns(self) -> int:
        """Remote minus local clock, if both ways took equally long."""
        return (self.t2_ns - self.t1_ns + self.t3_ns - self.t4_ns) // 2

    @property
    def round_trip_ns(self) -> int:
        """Time on the network, both ways."""
        return (self.t4_ns - self.t1_ns) - (self.t3_ns - self.t2_ns)


class ClockEstimator:
    """Follows a remote clock. Pure: local times come in with the exchanges and the questions."""

    def __init__(self) -> None:
        self._exchanges: deque[tuple[float, float, float]] = deque(maxlen=KEEP)
        self._disagreeing = 0
        self._base_t_ns = self._base_offset_ns = 0
        self._reference_ns = 0
        self._offset_ns = 0
        self._skew = 0.0
        self.uncertainty_ns = 0
        self.steps = 0

    @property
    def ready(self) -> bool:
        """Enough exchanges have come to use the estimate."""
        return len(self._exchanges) >= READY_AFTER

    @property
    def skew_ppm(self) -> float:
        """How much faster the remote clock runs, in parts per million."""
        return self._skew * 1e6

    def offset_ns(self, local_ns: int) -> int:
        """Remote minus local clock at a local time."""
        return self._offset_ns + round(self._skew * (local_ns - self._reference_ns))

    def remote_ns(self, local_ns: int) -> int:
        """The remote clock at a local time."""
        return local_ns + self.offset_ns(local_ns)

    def add(self, exchange: ClockExchange) -> bool:
        """Take an exchange; False when it is refused because it cannot be (negative times).

        One that contradicts the estimate is set aside, until enough of them in a row say that
        a clock has stepped: then the estimate starts afresh.
        """
        if exchange.round_trip_ns < 0 or exchange.t3_ns < exchange.t2_ns:
            return False
        if self.ready and self._contradicts(exchange):
            self._disagreeing += 1
            if self._disagreeing < STEP_AFTER:
                return True
            self._exchanges.clear()
            self.steps += 1
        self._disagreeing = 0
        if not self._exchanges:
            self._base_t_ns, self._base_offset_ns = exchange.t4_ns, exchange.offset_ns
        # Kept as differences, which are exact as floats whatever the clocks' own numbers are.
        since_ns = float(exchange.t4_ns - self._base_t_ns)
        drift_ns = float(exchange.offset_ns - self._base_offset_ns)
        self._exchanges.append((since_ns, drift_ns, float(exchange.round_trip_ns)))
        self._fit()
        return True

    def _contradicts(self, exchange: ClockExchange) -> bool:
        """The exchange and the estimate are further apart than both can be wrong."""
        error_ns = abs(exchange.offset_ns - self.offset_ns(exchange.t4_ns))
        return error_ns > exchange.round_trip_ns // 2 + self.uncertainty_ns + STEP_MARGIN_NS

    def _fit(self) -> None:
        """Weighted least squares, with the usual skew of clocks as what is known beforehand."""
        since_ns, drift_ns, round_trip_ns = np.array(self._exchanges).T
        best_ns = float(round_trip_ns.min())
        self.uncertainty_ns = int(best_ns) // 2
        # Half the extra round trip is how wrong an exchange can be beyond the best one; the
        # usual extra is added so that a lucky best one does not silence all the others.
        extra_ns = (round_trip_ns - best_ns) / 2
        doubt_ns = MIN_DOUBT_NS + float(np.median(extra_ns)) + extra_ns
        weight = 1 / (doubt_ns * doubt_ns)
        weight_sum = float(weight.sum())
        mean_t_ns = float(weight @ since_ns) / weight_sum
        mean_drift_ns = float(weight @ drift_ns) / weight_sum
        x, y = since_ns - mean_t_ns, drift_ns - mean_drift_ns
        skew = float((weight * x) @ y) / (float((weight * x) @ x) + USUAL_SKEW**-2)
        self._skew = min(max(skew, -MAX_SKEW), MAX_SKEW)
        self._reference_ns = self._base_t_ns + round(mean_t_ns)
        self._offset_ns = self._base_offset_ns + round(mean_drift_ns)
