"""Playing a trace by the delay that a rule says: the mean delay felt, and the share late."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from display_node.reception.playout_clock import PlayoutClock
from telepulse.reports.studies.playout_traces import DelayTrace, Nanoseconds


class DelayRule(Protocol):
    """Says which delay to use, from the delays of the frames that have come."""

    @property
    def delay_ns(self) -> int | None:
        """The delay to use now; None before the first frame."""

    def observe(self, delay_ns: int, now_ns: int) -> None:
        """A frame needed `delay_ns` and is here now."""


MakeRule = Callable[[float], DelayRule]


@dataclass(frozen=True, slots=True)
class PlayedTrace:
    """How a trace was played: mean delay of its frames in ms, share of them that came late."""

    delay_ms: float
    late: float


def play(rule: DelayRule, trace: DelayTrace, warped: bool = False) -> PlayedTrace:
    """Play a trace by what a rule says as its frames arrive.

    warped: the delay changes as the display's does, by 2 % at most; else at once.
    """
    arrived_ns = trace.arrived_ns.tolist()
    asked_ns: list[int] = []
    for delay_ns, now_ns in zip(trace.delay_ns.tolist(), arrived_ns, strict=True):
        rule.observe(delay_ns, now_ns)
        asked_ns.append(rule.delay_ns or 0)
    if warped:
        clock, asked = PlayoutClock(), [asked_ns[0], *asked_ns]
        asked_ns = [
            now_ns - clock.instant(now_ns, now_ns - before_ns)
            for now_ns, before_ns in zip(arrived_ns, asked, strict=False)
        ]
        # What holds from one arrival to the next is where the slew has come to by the next.
        asked_ns = [*asked_ns[1:], asked_ns[-1]]
    felt_ns = felt_delays_ns(trace, np.array(asked_ns, dtype=np.int64))
    return PlayedTrace(float(felt_ns.mean()) * 1e-6, float((trace.delay_ns > felt_ns).mean()))


def felt_delays_ns(trace: DelayTrace, asked_ns: Nanoseconds) -> Nanoseconds:
    """How late each frame's instant was played, both of shape (frames,).

    asked_ns[i] is the delay from arrival i until the next. An instant is played once, when it
    is first `delay` ago: a delay that grows because a frame came late cannot save that frame,
    and a delay that shrinks plays what it passes over at once.
    """
    arrived_ns = trace.arrived_ns
    # The newest instant played by the time of the next arrival.
    played_ns = np.maximum.accumulate(arrived_ns[1:] - asked_ns[:-1])
    during = np.searchsorted(played_ns, trace.sent_ns)
    felt_ns: Nanoseconds = np.maximum(asked_ns[during], arrived_ns[during] - trace.sent_ns)
    return felt_ns
