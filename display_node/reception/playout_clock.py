"""The playout clock: which instant of the pulse is felt now, and statistics of the delays played.

The perceived delay E is the one parameter: at time t the finger feels the pulse of t − E.
"""

from display_node.reception.delay_estimator import JUMP_NS, WARP_PARTS
from protocol.histogram import Histogram
from protocol.summary_tables import Compensation, PlayoutDelay


class PlayoutClock:
    """Turns time into the instant played, never faster or slower than a time-warp of 2 %.

    Changes of E and corrections of the clock offset are both slewed, so the finger feels no
    jump; a difference above 0.5 s (a clock that stepped, a new session) is jumped and counted.
    """

    def __init__(self) -> None:
        self._now_ns: int | None = None
        self._instant_ns = 0
        self.jumps = 0

    def instant(self, now_ns: int, wanted_ns: int) -> int:
        """Return the instant to play at `now_ns`, when `wanted_ns` is where it should be.

        Both clocks run at one rate within the warp; the result never goes back but by a jump.
        """
        if self._now_ns is None:
            self._now_ns, self._instant_ns = now_ns, wanted_ns
            return wanted_ns
        elapsed_ns = now_ns - self._now_ns
        error_ns = wanted_ns - self._instant_ns - elapsed_ns
        if abs(error_ns) > JUMP_NS:
            self.jumps += 1
        elif abs(error_ns) > elapsed_ns // WARP_PARTS:
            error_ns = elapsed_ns // WARP_PARTS * (1 if error_ns > 0 else -1)
        self._instant_ns += elapsed_ns + error_ns
        self._now_ns = now_ns
        return self._instant_ns


class PlayedDelays:
    """Counts the ticks while the stream was alive: `ticks` of them."""

    def __init__(self) -> None:
        self._playout_delay_ms = Histogram(0.5, 8_000)
        self._covered_ns = 0
        self._predicted = self._trusted = 0
        self.ticks = 0

    def add(self, playout_delay_ns: int, predicted_ns: int, trusted: bool) -> None:
        """Add a tick.

        Takes its E, the age of the newest sample relative to the played instant (0 where a sample
        was there), and whether the predictor was trusted.
        """
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
