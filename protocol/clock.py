"""Clock offset and skew between two hosts, from four-timestamp exchanges.

Offset is remote minus local. An exchange can be wrong by at most half its round trip, so the
shortest round trips tell most: the estimator keeps the best exchange of each second and draws
a line through them, each weighted by how much longer it took than the best of all.
"""

import statistics
from typing import NamedTuple

SLOT_NS = 1_000_000_000
SLOTS = 64
READY_AFTER = 3
MIN_DOUBT_NS = 20_000
SKEW_AFTER_NS = 20_000_000_000
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
        self._slots: list[tuple[int, ClockExchange]] = []
        self._count = 0
        self._disagreeing = 0
        self._reference_ns = 0
        self._offset_ns = 0.0
        self._skew = 0.0
        self.uncertainty_ns = 0
        self.steps = 0

    @property
    def ready(self) -> bool:
        """Enough exchanges have come to use the estimate."""
        return self._count >= READY_AFTER

    @property
    def skew_ppm(self) -> float:
        """How much faster the remote clock runs, in parts per million."""
        return self._skew * 1e6

    def offset_ns(self, local_ns: int) -> int:
        """Remote minus local clock at a local time."""
        return round(self._offset_ns + self._skew * (local_ns - self._reference_ns))

    def remote_ns(self, local_ns: int) -> int:
        """The remote clock at a local time."""
        return local_ns + self.offset_ns(local_ns)

    def add(self, exchange: ClockExchange) -> bool:
        """Take an exchange; False when it is refused because it cannot be (negative times)."""
        if exchange.round_trip_ns < 0 or exchange.t4_ns < exchange.t1_ns:
            return False
        if self.ready and self._stepped(exchange):
            self._slots.clear()
            self._count = 0
            self._skew = 0.0
            self.steps += 1
        slot = exchange.t4_ns // SLOT_NS
        if self._slots and self._slots[-1][0] == slot:
            if exchange.round_trip_ns < self._slots[-1][1].round_trip_ns:
                self._slots[-1] = (slot, exchange)
        else:
            self._slots.append((slot, exchange))
            del self._slots[:-SLOTS]
        self._count += 1
        self._fit()
        return True

    def _stepped(self, exchange: ClockExchange) -> bool:
        """A clock has stepped when several exchanges in a row contradict the estimate."""
        error_ns = abs(exchange.offset_ns - self.offset_ns(exchange.t4_ns))
        possible_ns = exchange.round_trip_ns // 2 + self.uncertainty_ns + STEP_MARGIN_NS
        self._disagreeing = self._disagreeing + 1 if error_ns > possible_ns else 0
        if self._disagreeing < STEP_AFTER:
            return False
        self._disagreeing = 0
        return True

    def _fit(self) -> None:
        """Weighted line through the best exchanges; level while they span too little."""
        best = min((exchange for _, exchange in self._slots), key=lambda e: e.round_trip_ns)
        self.uncertainty_ns = best.round_trip_ns // 2
        extras_ns = [(e.round_trip_ns - best.round_trip_ns) / 2 for _, e in self._slots]
        # Half the extra round trip is how wrong an exchange can be beyond the best one; the
        # usual extra is added so that a lucky best one does not silence all the others.
        usual_ns = MIN_DOUBT_NS + statistics.median(extras_ns)
        sum_w = sum_x = sum_y = sum_xx = sum_xy = 0.0
        for (_, exchange), extra_ns in zip(self._slots, extras_ns, strict=True):
            weight = (MIN_DOUBT_NS / (usual_ns + extra_ns)) ** 2
            x, y = exchange.t4_ns - best.t4_ns, exchange.offset_ns - best.offset_ns
            sum_w += weight
            sum_x += weight * x
            sum_y += weight * y
            sum_xx += weight * x * x
            sum_xy += weight * x * y
        self._skew = 0.0
        if self._slots[-1][1].t4_ns - self._slots[0][1].t4_ns >= SKEW_AFTER_NS:
            self._skew = (sum_w * sum_xy - sum_x * sum_y) / (sum_w * sum_xx - sum_x * sum_x)
        self._reference_ns = best.t4_ns
        self._offset_ns = best.offset_ns + (sum_y - self._skew * sum_x) / sum_w
