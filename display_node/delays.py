"""Statistics of the delays of all ticks that were played."""

from protocol.histogram import Histogram
from protocol.summary import Compensation, PlayoutDelay


class PlayedDelays:
    """Counts the ticks while the stream was alive: `ticks` of them."""

    def __init__(self) -> None:
        self._playout_delay_ms = Histogram(0.5, 8_000)
        self._covered_ns = 0
        self._predicted = self._trusted = 0
        self.ticks = 0

    def add(self, playout_delay_ns: int, predicted_ns: int, trusted: bool) -> None:
        """A tick: its E, by how much the newest sample was older than what was played (0 where
        that was there), and whether the predictor was trusted."""
        self._playout_delay_ms.add(playout_delay_ns * 1e-6)
        self._covered_ns += playout_delay_ns + predicted_ns
        self.ticks += 1
        self._predicted += predicted_ns > 0
        self._trusted += trusted

    @property
    def playout_delay_ms(self) -> PlayoutDelay:
        """Perceived delay E, in ms."""
        delay_ms = self._playout_delay_ms
        return PlayoutDelay(delay_ms.mean, delay_ms.quantile(0.99), delay_ms.beyond(p99=0.99))

    @property
    def covered_delay_ms(self) -> float | None:
        """Mean of what was buffered and predicted together, in ms."""
        return self._covered_ns / self.ticks * 1e-6 if self.ticks else None

    def compensation(self, may_trust: bool) -> Compensation:
        """Shares of the ticks; none of trust where the scene leaves it no say."""
        if not self.ticks:
            return Compensation()
        trusted = self._trusted / self.ticks if may_trust else None
        return Compensation(self._predicted / self.ticks, trusted)
