"""Set-points of the displays: permission to press, order, validity, and their account. Pure."""

from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass
from typing import Final

from protocol.summary.fields import PressFigures
from protocol.wire.messages import ProbeReport, SetPoint
from sensing_node.press.probe import Probe

# A display that sends no set-point for this long loses the permission to press. The probe has left
# the wrist by then (`ProbeLimits.leave_after_ns`).
HELD_FOR_NS: Final = 2_000_000_000
# Sensing clock of a set-point: within these bounds of the present, as for samples.
EARLIEST_NS, LATEST_NS = 60_000_000_000, 1_000_000_000
# Of so many numbers before the newest one it is known which have arrived; older ones are refused.
REMEMBERED: Final = 4_096
# A larger step of the numbers is no loss: at 50 a second, it is 20 minutes.
LARGEST_STEP: Final = 65_536
# Accounts of so many displays are kept apart.
MOST_HOLDERS: Final = 64
REASONS: Final = {
    "press_held": "another display presses, until it has sent none for 2 s",
    "timestamp": "its time is not near the present",
    "implausible": "its number is far beyond the newest",
    "too_old": "its number is far below the newest",
    "duplicate": "its number came before",
}
_FIGURES: Final = ("sent", "applied", "superseded", "lost")


class PressedProbe(ABC):
    """A probe that takes set-points, for example the synthetic wrist's. probe: its controller."""

    probe: Probe

    @property
    def state(self) -> str:
        """State of the probe: off, pressing, easing, leaving or fault."""
        return "fault" if self.probe.faults else self.probe.state

    def leave(self) -> None:  # noqa: B027
        """Take the probe off the wrist, at the end of the run."""

    @property
    def hold_down_n(self) -> float:
        """Static force that the load cell measures."""
        return self.probe.hold_down_n

    @property
    @abstractmethod
    def depth_m(self) -> float:
        """Depth of the probe in the wrist; at most 0 off it."""

    @abstractmethod
    def press(self, force_n: float) -> None:
        """Take a set-point in N."""


@dataclass(slots=True)
class PressHolder:
    """The display that may press: its run, its account, and which of its numbers have arrived.

    arrived: bit i is set if number newest − i has arrived. force_n: the newest applied one.
    """

    press: int
    seen_ns: int
    newest: int = -1
    arrived: int = 0
    applied: int = 0
    superseded: int = 0
    force_n: float = 0.0

    def outcomes(self) -> dict[str, int]:
        """Return the account of the set-points up to the newest one that arrived."""
        sent, applied, superseded = self.newest + 1, self.applied, self.superseded
        counts = (sent, applied, superseded, sent - applied - superseded)
        return dict(zip(_FIGURES, counts, strict=True))

    def arrive(self, number: int) -> str | None:
        """Mark a number as arrived; return the cause if it is refused."""
        ahead = number - self.newest
        if ahead > LARGEST_STEP:
            return "implausible"
        if ahead > 0:
            self.arrived = (self.arrived << ahead | 1) & ((1 << REMEMBERED) - 1)
            self.newest = number
            return None
        if -ahead >= REMEMBERED:
            return "too_old"
        if self.arrived >> -ahead & 1:
            return "duplicate"
        self.arrived |= 1 << -ahead
        return None


class SetPointServer:
    """Server of one session's set-points. The first display to press holds the permission.

    It keeps the permission until it is silent for `HELD_FOR_NS`; set-points of others are refused
    until then, as are repeated, old and implausible ones.

    rejected: refused set-points by cause.
    """

    def __init__(self, session: int, probe: PressedProbe) -> None:
        self._session, self._probe = session, probe
        self._holder: PressHolder | None = None
        # The displays that have pressed, by their run; the sums of those that were forgotten.
        self._holders: dict[int, PressHolder] = {}
        self._forgotten = Counter(dict.fromkeys(_FIGURES, 0))
        self.rejected: Counter[str] = Counter()

    def answer(self, message: SetPoint, now_ns: int) -> ProbeReport:
        """Apply a set-point of this session if it may be; return its display's account."""
        holder = self._holder
        if holder is None or now_ns - holder.seen_ns > HELD_FOR_NS:
            holder = self._holder = self._admit(message.press, now_ns)
        if message.press != holder.press:
            self.rejected["press_held"] += 1
            return self._report(PressHolder(message.press, now_ns), "held")
        if not -LATEST_NS <= now_ns - message.t_ns <= EARLIEST_NS:
            self.rejected["timestamp"] += 1
        else:
            newest = holder.newest
            cause = holder.arrive(message.number)
            if cause is not None:
                self.rejected[cause] += 1
            else:
                holder.seen_ns = now_ns
                if now_ns - message.t_ns > message.valid_for_ns:
                    holder.superseded += 1
                elif message.number < newest:
                    holder.superseded += 1
                    # It shows that the finger still presses: the newest one is not stale yet.
                    self._probe.press(holder.force_n)
                else:
                    holder.applied += 1
                    holder.force_n = message.force_n
                    self._probe.press(message.force_n)
        return self._report(holder, self._probe.state)

    def figures(self) -> PressFigures:
        """Return the account of all displays that have pressed, and the state of the probe."""
        totals, probe = self._forgotten.copy(), self._probe
        for holder in self._holders.values():
            totals.update(holder.outcomes())
        return PressFigures(**totals, hold_down_n=probe.hold_down_n, probe=probe.state)

    def _admit(self, press: int, now_ns: int) -> PressHolder:
        """Give the permission to a display; one that had it before continues its account."""
        holders = self._holders
        holder = holders.pop(press, None) or PressHolder(press, now_ns)
        if len(holders) >= MOST_HOLDERS:
            self._forgotten.update(holders.pop(next(iter(holders))).outcomes())
        holder.seen_ns = now_ns
        holders[press] = holder
        return holder

    def _report(self, holder: PressHolder, state: str) -> ProbeReport:
        return ProbeReport(
            self._session,
            holder.press,
            holder.newest + 1,
            holder.applied,
            holder.superseded,
            self.rejected.total(),
            state,
            self._probe.hold_down_n,
            self._probe.depth_m,
        )
