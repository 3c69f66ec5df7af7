"""Published rules for the playout delay, and the playing of a trace by a rule.

For speech, delays change between talkspurts only. A pulse has no such pauses, so each rule sets a
delay after every frame. Written from the papers' equations. Delays and times are in ns.
"""

from bisect import bisect_left, insort
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Protocol

import numpy as np

from benchmarks.playout.links import DelayTrace, Nanoseconds
from display_node.reception.playout import PlayoutClock


class DelayRule(Protocol):
    """A rule that sets the playout delay from the delays of the frames that have arrived."""

    @property
    def delay_ns(self) -> int | None:
        """Delay to use now; None before the first frame."""

    def observe(self, delay_ns: int, now_ns: int) -> None:
        """Add the delay of a frame that arrives now."""


MakeRule = Callable[[float], DelayRule]


class PlayedTrace(NamedTuple):
    """Mean delay in ms at which a trace's frames were played, and the share that came late."""

    delay_ms: float
    late: float


def play(rule: DelayRule, trace: DelayTrace, warped: bool = False) -> PlayedTrace:
    """Play a trace by the delay that a rule sets as the frames arrive.

    With `warped` the delay changes by at most 5 % of time, as in a display; otherwise at once.
    """
    arrived_ns = trace.arrived_ns.tolist()
    set_ns: list[int] = []
    for delay_ns, now_ns in zip(trace.delay_ns.tolist(), arrived_ns, strict=True):
        rule.observe(delay_ns, now_ns)
        set_ns.append(rule.delay_ns or 0)
    if warped:
        clock, before = PlayoutClock(), [set_ns[0], *set_ns]
        set_ns = [
            now_ns - clock.instant(now_ns, now_ns - before_ns)
            for now_ns, before_ns in zip(arrived_ns, before, strict=False)
        ]
        # With a slew, the delay in use until the next arrival is the one reached at that arrival.
        set_ns = [*set_ns[1:], set_ns[-1]]
    felt_ns = felt_delays_ns(trace, np.array(set_ns, dtype=np.int64))
    return PlayedTrace(float(felt_ns.mean()) * 1e-6, float((trace.delay_ns > felt_ns).mean()))


def felt_delays_ns(trace: DelayTrace, set_ns: Nanoseconds) -> Nanoseconds:
    """Return the delay at which each frame's instant was played, shape (frames,).

    set_ns[i] is the delay in use from arrival i until the next. Each instant is played once, as
    soon as its age reaches the delay in use. So a delay that grows because a frame came late cannot
    save that frame, and when the delay shrinks, the skipped instants are played at once.
    """
    arrived_ns = trace.arrived_ns
    # The newest instant played by the time of the next arrival.
    played_ns = np.maximum.accumulate(arrived_ns[1:] - set_ns[:-1])
    during = np.searchsorted(played_ns, trace.sent_ns)
    felt_ns: Nanoseconds = np.maximum(set_ns[during], arrived_ns[during] - trace.sent_ns)
    return felt_ns


MS = 1_000_000


class FixedDelay:
    """The first frame's delay plus a constant reserve, chosen beforehand."""

    def __init__(self, reserve_ns: int) -> None:
        self._reserve_ns = reserve_ns
        self.delay_ns: int | None = None

    def observe(self, delay_ns: int, now_ns: int) -> None:
        """Add the delay of a frame that arrives now."""
        if self.delay_ns is None:
            self.delay_ns = delay_ns + self._reserve_ns


class Ramjee1:
    """Mean + β · mean deviation, both by exponential smoothing with α = 0.998002.

    Algorithm 1 of Ramjee, Kurose, Towsley and Schulzrinne, "Adaptive playout mechanisms for
    packetized audio applications in wide-area networks", INFOCOM 1994; β = 4 there.
    """

    ALPHA = 0.998002

    def __init__(self, beta: float) -> None:
        self._beta = beta
        self._mean_ns = self._deviation_ns = 0.0
        self.delay_ns: int | None = None

    def observe(self, delay_ns: int, now_ns: int) -> None:
        """Add the delay of a frame that arrives now."""
        if self.delay_ns is None:
            self._mean_ns = float(delay_ns)
        self._set(delay_ns, self.ALPHA * self._mean_ns + (1 - self.ALPHA) * delay_ns)

    def _set(self, delay_ns: int, mean_ns: float) -> None:
        self._mean_ns = mean_ns
        off_ns = abs(delay_ns - mean_ns)
        self._deviation_ns = self.ALPHA * self._deviation_ns + (1 - self.ALPHA) * off_ns
        self.delay_ns = round(mean_ns + self._beta * self._deviation_ns)


class Ramjee4(Ramjee1):
    """Algorithm 4 of Ramjee et al., INFOCOM 1994: smoothing with α = 0.875, and a spike mode.

    A step of more than twice the deviation + 100 ms begins a spike, in which the mean follows
    each delay; it ends when its slope has flattened to 63/8 ms. (The paper's 800 and 63 are in
    samples of 8 kHz speech.) β = 4.
    """

    ALPHA = 0.875
    STEP_NS = 100 * MS
    FLAT_NS = 63 * MS / 8

    def __init__(self, beta: float) -> None:
        super().__init__(beta)
        self._slope_ns = 0.0
        self._last_ns = self._before_ns = 0
        self._spike = False

    def observe(self, delay_ns: int, now_ns: int) -> None:
        """Add the delay of a frame that arrives now."""
        if self.delay_ns is None:
            self._last_ns = self._before_ns = delay_ns
        last_ns, before_ns = self._last_ns, self._before_ns
        self._last_ns, self._before_ns = delay_ns, last_ns
        if not self._spike:
            if abs(delay_ns - last_ns) > 2 * self._deviation_ns + self.STEP_NS:
                self._spike, self._slope_ns = True, 0.0
        else:
            turn_ns = abs(2 * delay_ns - last_ns - before_ns) / 8
            self._slope_ns = self._slope_ns / 2 + turn_ns
            if self._slope_ns <= self.FLAT_NS:
                self._spike = False
                return
        if self._spike:
            self._set(delay_ns, self._mean_ns + (delay_ns - last_ns))
        else:
            super().observe(delay_ns, now_ns)


class MoonPercentile:
    """The percentile of the last 10 000 delays, and a spike mode that plays with each delay.

    Moon, Kurose and Towsley, "Packet audio playout delay adjustment: performance bounds and
    algorithms", Multimedia Systems 6 (1998): a spike begins above 4 × the delay in use, and
    ends below 2 × the one before it; 99 %. Delays count from the smallest seen.
    """

    WINDOW = 10_000
    HEAD, TAIL = 4, 2

    def __init__(self, late_target: float) -> None:
        self._late_target = late_target
        self._window: deque[int] = deque()
        self._sorted: list[int] = []
        self._smallest_ns = 0
        self._before_spike_ns: int | None = None
        self.delay_ns: int | None = None

    def observe(self, delay_ns: int, now_ns: int) -> None:
        """Add the delay of a frame that arrives now."""
        if self.delay_ns is None:
            self._smallest_ns = self.delay_ns = delay_ns
        smallest_ns = self._smallest_ns = min(self._smallest_ns, delay_ns)
        excess_ns, used_ns = delay_ns - smallest_ns, self.delay_ns - smallest_ns
        if self._before_spike_ns is not None:
            if excess_ns <= self.TAIL * self._before_spike_ns:
                self._before_spike_ns = None
        elif len(self._window) > 1 and excess_ns > self.HEAD * used_ns:
            self._before_spike_ns = used_ns
        if self._before_spike_ns is not None:
            self.delay_ns = delay_ns
            return
        self._count(delay_ns)
        allowed = int(self._late_target * len(self._sorted))
        self.delay_ns = self._sorted[-1 - allowed]

    def _count(self, delay_ns: int) -> None:
        self._window.append(delay_ns)
        insort(self._sorted, delay_ns)
        if len(self._window) > self.WINDOW:
            del self._sorted[bisect_left(self._sorted, self._window.popleft())]


class NetEqLike:
    """The smallest delay of 2 s, and over it a quantile of the largest excess of each 500 ms.

    As the delay manager of WebRTC's NetEQ with its defaults: buckets of 20 ms, 100 of
    them, forgetting by 0.983 a count, the quantile 0.95, its bucket's upper edge
    (modules/audio_coding/neteq, 2023). Its reordering and packet-count limits are not here.
    """

    HISTORY_NS = 2_000 * MS
    EVERY_NS = 500 * MS
    BUCKET_NS, BUCKETS = 20 * MS, 100
    FORGET = 0.983
    START_NS = 80 * MS

    def __init__(self, late_target: float) -> None:
        self._late_target = late_target
        self._window: deque[tuple[int, int]] = deque()
        self._shares = [0.0] * self.BUCKETS
        self._largest_ns = 0
        self._count_at_ns: int | None = None
        self._target_ns = self.START_NS
        self.delay_ns: int | None = None

    def observe(self, delay_ns: int, now_ns: int) -> None:
        """Add the delay of a frame that arrives now."""
        window = self._window
        while window and window[-1][1] >= delay_ns:
            window.pop()
        window.append((now_ns, delay_ns))
        while window[0][0] < now_ns - self.HISTORY_NS:
            window.popleft()
        base_ns = window[0][1]
        self._largest_ns = max(self._largest_ns, delay_ns - base_ns)
        if self._count_at_ns is None:
            self._count_at_ns = now_ns + self.EVERY_NS
        elif now_ns >= self._count_at_ns:
            self._count(min(self._largest_ns // self.BUCKET_NS, self.BUCKETS - 1))
            self._largest_ns, self._count_at_ns = 0, now_ns + self.EVERY_NS
        self.delay_ns = base_ns + self._target_ns

    def _count(self, bucket: int) -> None:
        self._shares = [share * self.FORGET for share in self._shares]
        self._shares[bucket] += 1 - self.FORGET
        above, allowed = 0.0, self._late_target * sum(self._shares)
        position = self.BUCKETS - 1
        while position and above + self._shares[position] <= allowed:
            above += self._shares[position]
            position -= 1
        self._target_ns = (position + 1) * self.BUCKET_NS
