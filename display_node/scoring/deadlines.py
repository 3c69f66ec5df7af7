"""Alarm on missed ticks, by their share and by the longest gap. Pure."""

from collections import deque
from collections.abc import Mapping
from typing import Any

from protocol.summary.fields import Deadlines

WINDOW_NS = 5_000_000_000
# Above this share of the window's ticks the alarm begins; it ends below half of it.
ALARM_SHARE = 0.01
# Longest gap without an alarm: the default watchdog of a drive, also for displays without one.
GAP_NS = 50_000_000


def deadline_alarm(loop: Mapping[str, Any]) -> str | None:
    """Return the text of the deadline alarm of a summary's `loop`; None while it is off."""
    if not loop.get("late"):
        return None
    last = loop.get("last_5s", {})
    missed, gap_ms = last.get("missed"), last.get("gap_ms")
    # Statuses of other programs may lack these figures.
    share = "too many" if missed is None else f"{100 * missed:.1f} %"
    gap = "" if gap_ms is None else f", longest gap {gap_ms:.0f} ms"
    return f"{share} of the ticks of the last 5 s missed{gap}"


class DeadlineWatch:
    """Alarm on a loop's missed ticks over the last 5 s.

    A single missed tick is not felt. The alarm is on from more than 1 % of missed ticks in the last
    5 s until less than 0.5 %, and for 5 s after a gap longer than `gap_ns` (a drive's watchdog).
    """

    def __init__(self, tick_ns: int, gap_ns: int = GAP_NS) -> None:
        self._tick_ns = tick_ns
        self._gap_ns = gap_ns
        # Late ticks of the window: time in ns, and ticks since the one before.
        self._late: deque[tuple[int, int]] = deque()
        self._missed = self._most_missed = self._longest_ticks = 0
        self._gap_at_ns: int | None = None
        self.alarm = False

    def add(self, now_ns: int, elapsed_ticks: int) -> None:
        """Count one tick that began `elapsed_ticks` periods after the last one."""
        late = self._late
        if elapsed_ticks > 1:
            late.append((now_ns, elapsed_ticks))
            self._missed += elapsed_ticks - 1
            self._longest_ticks = max(self._longest_ticks, elapsed_ticks)
            if elapsed_ticks * self._tick_ns > self._gap_ns:
                self._gap_at_ns = now_ns
        elif not late:
            return
        while late and late[0][0] <= now_ns - WINDOW_NS:
            self._missed -= late.popleft()[1] - 1
        self._most_missed = max(self._most_missed, self._missed)
        limit = ALARM_SHARE / 2 if self.alarm else ALARM_SHARE
        after_gap = self._gap_at_ns is not None and now_ns - self._gap_at_ns < WINDOW_NS
        self.alarm = after_gap or self._share(self._missed) > limit

    @property
    def last_5s(self) -> Deadlines:
        """Share of ticks missed in the last 5 s, and the longest gap among them."""
        longest = max((elapsed for _, elapsed in self._late), default=1)
        return self._deadlines(self._missed, longest)

    @property
    def worst_5s(self) -> Deadlines:
        """Largest share of ticks missed in any 5 s so far, and the longest gap."""
        return self._deadlines(self._most_missed, max(1, self._longest_ticks))

    def _deadlines(self, missed: int, longest_ticks: int) -> Deadlines:
        return Deadlines(self._share(missed), longest_ticks * self._tick_ns * 1e-6)

    def _share(self, missed: int) -> float:
        return min(1.0, missed * self._tick_ns / WINDOW_NS)
