"""Delay that was felt, and how much of it was predicted. Pure."""

import numpy as np

from protocol.histogram import Histogram
from protocol.summary.fields import Compensation, PlayoutDelay
from protocol.ticks import TickBlock


class PlayedDelays:
    """Statistics of the ticks in which the stream was alive; `ticks` is their number."""

    def __init__(self) -> None:
        self._playout_delay_ms = Histogram(0.5, 8_000)
        self._covered_ns = self._predicted_ns = 0
        self._predicted = self._trusted = 0
        self.ticks = 0

    def add(self, block: TickBlock) -> None:
        """Add the ticks of a block."""
        ticks = block.columns
        played = ticks.predicted_ns >= 0
        delay_ns = (ticks.sensing_now_ns - ticks.instant_ns)[played]
        predicted_ns = ticks.predicted_ns[played]
        self.ticks += len(delay_ns)
        self._playout_delay_ms.add_all(np.multiply(delay_ns, 1e-6))
        ahead_ns = int(predicted_ns.sum())
        self._covered_ns += int(delay_ns.sum()) + ahead_ns
        self._predicted += int(np.count_nonzero(predicted_ns))
        self._predicted_ns += ahead_ns
        self._trusted += int(np.count_nonzero(ticks.trusted[played]))

    @property
    def playout_delay_ms(self) -> PlayoutDelay:
        """Playout delay E, in ms."""
        delay_ms = self._playout_delay_ms
        return PlayoutDelay(delay_ms.mean, **delay_ms.quantiles(p99=0.99))

    @property
    def covered_delay_ms(self) -> float | None:
        """Mean age of the data, in ms: the delay that playout and prediction bridge together."""
        return self._covered_ns / self.ticks * 1e-6 if self.ticks else None

    def compensation(self, may_trust: bool) -> Compensation:
        """Return shares of the ticks; `trusted` is None unless the scene lets trust reduce E."""
        if not self.ticks:
            return Compensation()
        horizon_ms = self._predicted_ns / self._predicted * 1e-6 if self._predicted else None
        trusted = self._trusted / self.ticks if may_trust else None
        return Compensation(self._predicted / self.ticks, horizon_ms, trusted)
