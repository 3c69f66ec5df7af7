"""What happened, in words: told from one status of a display to the next."""

from collections.abc import Iterator
from typing import NamedTuple

from protocol.limits import NAMES
from protocol.summary import Summary


class Event(NamedTuple):
    """Something that happened; level is INFO, WARNING or ERROR, name its short word."""

    level: str
    name: str
    text: str


_LEVELS = {"stale": "WARNING", "fault": "ERROR"}


class StatusWatch:
    """Notices what has changed between statuses, which come five times a second."""

    def __init__(self) -> None:
        self._state = ""
        self._last = Summary()

    def take(self, state: str, summary: Summary) -> Iterator[Event]:
        """The events that a status tells of."""
        last, self._last = self._last, summary
        if state != self._state:
            before = f", was {self._state}" if self._state else ""
            self._state = state
            yield Event(_LEVELS.get(state, "INFO"), "state", f"{state}{before}")
        for fault in summary.faults:
            if fault not in last.faults:
                yield Event("ERROR", "fault", fault)
        steps = summary.clock.steps or 0
        if steps > (last.clock.steps or 0):
            yield Event("WARNING", "clock step", f"a clock has stepped, {steps} times so far")
        # Once for each limit: how often and for how long is in the statuses.
        for limit, name in NAMES.items():
            times = getattr(summary.limited, limit).times or 0
            if times and not getattr(last.limited, limit).times:
                yield Event("WARNING", "limited", f"{name} reached")
        # Once for each cause: how many there were is in the statuses.
        for cause in summary.rejected.keys() - last.rejected.keys():
            yield Event("WARNING", "refused", f"{summary.rejected[cause]} messages: {cause}")
