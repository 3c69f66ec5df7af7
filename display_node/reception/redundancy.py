"""Number of data connections with `paths = "auto"`: more where TCP stalls. Pure.

TCP delivers in order. After a lost packet it holds all later ones back until the repetition has
arrived, which takes a round trip or more; then everything comes at once. This head-of-line blocking
is called a stall here. Another connection loses other packets, so that the first copies of the
frames are held back only while all connections stall at the same time.
"""

from collections import deque

# With more than one connection at the start, no further one is opened: see decision 33.
MAX_PATHS = 3
# Stalls are counted within this time. One stall may be chance; a loss of 1 % makes one a second.
WINDOW_NS = 10_000_000_000
LEAST_STALLS = 2
# A shorter gap is as likely a stall of a program, and costs less delay than a finger notices.
LEAST_STALL_NS = 20_000_000
# A gap is no stall unless it exceeds a frame by this many times the mean excess, which jitter has.
# An hour of jitter opens nothing then (tests/unit/display_node/reception/test_redundancy.py).
JITTERS = 10
AVERAGED_GAPS = 256
# A bunch after a gap has at least this share of the frames that were due in it, and comes within
# this time.
BUNCH, LEAST_BUNCH = 0.8, 2
BUNCH_NS = 5_000_000
# Connections that stall together, by this share of the first one's stalls, share the cause: a queue
# that is full, a sensing node or a radio link that pauses. More of them do not help.
TOGETHER = 0.75
BARRED_NS = 600_000_000_000
# Stalls may use up this part of the share of late frames, so that the delay's quantile, from which
# the perceived delay follows, is that of the link without loss.
SPARED = 0.1
# The further connections are closed once one alone would have been enough for this time.
CALM_NS = 300_000_000_000
_NEVER_NS = 1 << 62


class StallMeter:
    """Detector of stalls from the times at which frames arrive.

    A stall is a gap that is longer than a lost packet's repetition takes at least, and much longer
    than usual gaps, and a bunch of frames after it. A pause of the stream has no bunch. A gap
    longer than the time after which a connection is replaced is an outage (`failover.py`).
    """

    def __init__(self) -> None:
        self._frame_ns = self._least_ns = self._most_ns = _NEVER_NS
        self._received_ns = _NEVER_NS
        # Mean of the time by which a gap exceeds a frame's duration, without stalls.
        self._jitter_ns = 0.0
        # After a gap: by how much it exceeds a frame, the frames still missing of a bunch, and by
        # when they are due.
        self._stalled_ns, self._owed, self._bunch_ns = 0, 0.0, 0
        # End and length of each stall in the window.
        self._stalls: deque[tuple[int, int]] = deque()

    def set_times(self, frame_ns: int, round_trip_ns: int, outage_ns: int) -> None:
        """Expect a frame every `frame_ns`; a gap from `outage_ns` on is an outage."""
        self._frame_ns, self._most_ns = frame_ns, outage_ns
        # The next frame's acknowledgement reveals a loss, and the repetition arrives a round trip
        # after that frame was sent: a gap of two frames and a round trip.
        self._least_ns = max(LEAST_STALL_NS, round_trip_ns)

    def received(self, count: int, now_ns: int, polled_ns: int) -> bool:
        """Take `count` frames that came after `polled_ns`; return whether they end a stall.

        polled_ns: time at which none had come yet. While this process stalls, frames queue; the
        gap is therefore counted until that time only.
        """
        gap_ns, self._received_ns = polled_ns - self._received_ns, now_ns
        excess_ns = max(0, gap_ns - self._frame_ns)
        if excess_ns >= self._least_ns and excess_ns >= JITTERS * self._jitter_ns:
            self._stalled_ns = excess_ns
            self._owed = max(LEAST_BUNCH, BUNCH * gap_ns / self._frame_ns)
            self._bunch_ns = now_ns + BUNCH_NS
        else:
            self._jitter_ns += (excess_ns - self._jitter_ns) / AVERAGED_GAPS
            if self._owed <= 0:
                return False
        self._owed -= count
        if now_ns > self._bunch_ns:
            self._owed = 0.0
        elif self._owed <= 0 and self._stalled_ns < self._most_ns:
            self._stalls.append((now_ns, self._stalled_ns))
            return True
        return False

    def recent(self, now_ns: int) -> tuple[int, float]:
        """Return number of stalls in the window before `now_ns`, and the share of it they took."""
        stalls = self._stalls
        while stalls and now_ns - stalls[0][0] > WINDOW_NS:
            stalls.popleft()
        return len(stalls), sum(length_ns for _, length_ns in stalls) / WINDOW_NS


class Redundancy:
    """Decision on how many connections carry the frames of one address.

    A second one is opened when stalls recur and take a larger share of the time than `late_target`.
    If connections stall independently of one another, two stall together for the square of that
    share; a third one is opened if this is more than a tenth of `late_target`.

    paths: number of connections to use. stalls, opened: number of stalls of the first connection,
    and of further connections opened for them.
    """

    def __init__(self, late_target: float) -> None:
        self._late_target = late_target
        self._first, self._merged = StallMeter(), StallMeter()
        self._review_ns = _NEVER_NS
        self._opened_ns = self._needed_ns = self._barred_until_ns = 0
        self.paths = 1
        self.stalls = self.opened = 0

    def set_times(self, frame_ns: int, round_trip_ns: int, outage_ns: int) -> None:
        """Set what `StallMeter.set_times` takes."""
        for meter in (self._first, self._merged):
            meter.set_times(frame_ns, round_trip_ns, outage_ns)

    def received(self, first: int, merged: int, now_ns: int, polled_ns: int) -> None:
        """Take the frames that came since the last call, at `polled_ns`.

        first: number of those over the first connection. merged: of those over any.
        """
        if merged and self.paths > 1:
            self._merged.received(merged, now_ns, polled_ns)
        if first and self._first.received(first, now_ns, polled_ns):
            self.stalls += 1
            self._review_ns = now_ns

    def change(self, now_ns: int) -> str:
        """Change `paths` if that is due, and return the reason; empty without a change."""
        if now_ns < self._review_ns:
            return ""
        count, share = self._first.recent(now_ns)
        if count >= LEAST_STALLS and share > self._late_target:
            self._needed_ns = now_ns
        if self.paths > 1:
            together, merged = self._merged.recent(now_ns)
            self._review_ns = self._needed_ns + CALM_NS
            if now_ns >= self._review_ns:
                return self._close(f"TCP has hardly stalled for {CALM_NS // 60_000_000_000} min")
            judged = now_ns - self._opened_ns >= WINDOW_NS
            if judged and together >= LEAST_STALLS and merged > TOGETHER * share:
                self._barred_until_ns = now_ns + BARRED_NS
                return self._close("all connections stall at the same time")
        else:
            self._review_ns = _NEVER_NS
        wanted = share**self.paths > SPARED * self._late_target
        if (
            self._needed_ns != now_ns
            or not wanted
            or self.paths == MAX_PATHS
            or now_ns < self._barred_until_ns
        ):
            return ""
        self.paths += 1
        self.opened += 1
        self._opened_ns = now_ns
        self._review_ns = min(self._review_ns, now_ns + WINDOW_NS)
        return f"TCP stalled for {share:.1%} of the last {WINDOW_NS // 10**9} s"

    def _close(self, reason: str) -> str:
        self.paths, self._review_ns = 1, _NEVER_NS
        self._merged = StallMeter()
        return reason
