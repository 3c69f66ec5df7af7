"""Events of a display, detected from successive statuses and from frames. Pure."""

from collections.abc import Hashable, Iterator, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from display_node.telemetry.alerts import Alert, AlertKind, alerts
from protocol.refusals import REVOKED, explain_causes
from protocol.summary.fields import contactors_of
from protocol.summary.phrases import LIMIT_NAMES

# A cut is reported after the time that a display waits for a sensing node.
CUT_AFTER_NS = 1_000_000_000
INTERRUPTED = "felt again"
# Counts of the bench are an event when they grow by more than this within one status; superseded
# commands are usual.
MANY, USUAL = 20, "drive superseded"
# Key of a summary → kind of the event of each cause in it.
REFUSALS = {"rejected": AlertKind.REFUSED, "rejected_readers": AlertKind.READER_REFUSED}
# Alerts that other events report already: those of the state and of each cause of refusal.
OTHER_EVENTS = {AlertKind.STALE, AlertKind.NOT_CONNECTED}


_CUT = Alert(AlertKind.LINK_CUT, "no frame")


class Event(NamedTuple):
    """An event; level: INFO, WARNING or ERROR; name: its kind, short."""

    level: str
    name: str
    text: str


_LEVELS = {"stale": "WARNING", "fault": "ERROR"}


class EventDetector:
    """Detector of changes between a display's statuses, which come each 0.4 s.

    A condition that lasts gives two events: one when it begins, one with its length when it ends.
    """

    def __init__(self) -> None:
        self._state, self._state_ns = "", 0
        self._joined = self._ended = False
        # When the last frame arrived; None before the first.
        self._frame_ns: int | None = None
        # Each condition that lasts, and its begin, by its identity.
        self._lasting_since: dict[Hashable, tuple[Alert, int]] = {}
        self._steps = 0
        # Number and length in s of the reported interruptions; None before the first status.
        self._interruptions: tuple[int, float] | None = None
        self._limited: set[str] = set()
        self._refused: set[tuple[str, str]] = set()
        # Counts of the bench at the last status, and the names of those that were reported.
        self._hardware: dict[tuple[str, str], int] = {}
        self._frequent: set[tuple[str, str]] = set()

    def begin_session(self) -> None:
        """Note that the display joins a stream, whose frames are to arrive."""
        self._joined = self._ended = False
        self._frame_ns = None

    def end_stream(self) -> None:
        """Expect no further frames."""
        self._ended = True

    def arrive(self, now_ns: int) -> Iterator[Event]:
        """Note the arrival of a frame; yield the end of a cut."""
        self._frame_ns = now_ns
        yield from self._over(_CUT.identity, now_ns)

    def take(self, state: str, summary: Mapping[str, Any], now_ns: int) -> Iterator[Event]:
        """Yield the events since the last status; now_ns: time of this one, display's clock."""
        if state != self._state:
            seconds = (now_ns - self._state_ns) * 1e-9
            before = f", was {self._state} for {seconds:.1f} s" if self._state else ""
            self._state, self._state_ns = state, now_ns
            yield Event(_LEVELS.get(state, "INFO"), "state", f"{state}{before}")
        if state == "playing" and not self._joined:
            self._joined = True
            before_joining = summary["samples"].get("before_joining") or 0
            yield Event("INFO", "join", f"the pulse is felt; samples sent before: {before_joining}")
        wrong = [alert for alert in alerts(state, summary) if alert.kind not in OTHER_EVENTS]
        yield from self._lasting([*wrong, *self._cut(now_ns)], now_ns)
        yield from self._interrupted(summary.get("interruptions", {}))
        yield from self._counted(summary)

    def _interrupted(self, known: Mapping[str, Any]) -> Iterator[Event]:
        """Yield the interruptions that ended since the last status, also short ones."""
        count, seconds = known.get("count") or 0, known.get("seconds") or 0.0
        named = self._interruptions
        self._interruptions = count, seconds
        if named is None or count <= named[0]:
            return
        new, text = count - named[0], f"after {seconds - named[1]:.2f} s without the whole pulse"
        if new > 1:
            text += f", interrupted {new} times"
        began_s, ended_s = known.get("began_s"), known.get("ended_s")
        if began_s is not None and ended_s is not None:
            last = ", the last" if new > 1 else ":"
            text += f"{last} from {began_s:.2f} to {ended_s:.2f} s of the run"
        yield Event("WARNING", INTERRUPTED, text)

    def _counted(self, summary: Mapping[str, Any]) -> Iterator[Event]:
        """Yield an event for each count that is new, and for frequent errors of the bench.

        The statuses contain the number, and where it applies the time, of each clock step, limit
        and refusal.
        """
        steps = summary["clock"].get("steps") or 0
        if steps > self._steps:
            yield Event("WARNING", "clock step", f"a clock has jumped; jumps so far: {steps}")
        self._steps = steps
        for contactor, figures in contactors_of(summary).items():
            of = f"{contactor}: " if contactor else ""
            for limit, name in LIMIT_NAMES.items():
                reached = f"{of}{name} reached"
                if figures["limited"][limit].get("times") and reached not in self._limited:
                    self._limited.add(reached)
                    yield Event("WARNING", "limited", reached)
        for key, kind in REFUSALS.items():
            refused = summary.get(key, {})
            for cause in sorted(refused.keys() - {REVOKED}):
                if (key, cause) not in self._refused:
                    self._refused.add((key, cause))
                    yield Event("WARNING", kind.value, *explain_causes({cause: refused[cause]}))
        hardware = {
            (contactor, name): count
            for contactor, figures in contactors_of(summary).items()
            for name, count in figures.get("hardware", {}).items()
            if name != USUAL
        }
        for contactor, name in sorted(hardware.keys() - self._frequent):
            more = hardware[contactor, name] - self._hardware.get((contactor, name), 0)
            if more > MANY:
                self._frequent.add((contactor, name))
                of = f"{contactor}: " if contactor else ""
                yield Event("WARNING", "hardware", f"{of}{name}: {more} within one status")
        self._hardware = hardware

    def _cut(self, now_ns: int) -> list[Alert]:
        if self._frame_ns is None or self._ended or now_ns - self._frame_ns <= CUT_AFTER_NS:
            return []
        return [replace(_CUT, reason=f"no frame for {(now_ns - self._frame_ns) * 1e-9:.1f} s")]

    def _lasting(self, wrong: list[Alert], now_ns: int) -> Iterator[Event]:
        present = {alert.identity for alert in wrong}
        for identity in [each for each in self._lasting_since if each not in present]:
            yield from self._over(identity, now_ns)
        for alert in wrong:
            if alert.identity not in self._lasting_since:
                # A cut began with the last frame that arrived.
                began_ns = self._frame_ns if alert.kind is AlertKind.LINK_CUT else now_ns
                self._lasting_since[alert.identity] = (
                    alert,
                    now_ns if began_ns is None else began_ns,
                )
                level = "ERROR" if alert.kind is AlertKind.FAULT else "WARNING"
                of = f"{alert.subject}: " if alert.subject else ""
                yield Event(level, alert.kind.value, f"{of}{alert.text}")

    def _over(self, identity: Hashable, now_ns: int) -> Iterator[Event]:
        found = self._lasting_since.pop(identity, None)
        if found is not None:
            alert, began_ns = found
            yield Event("INFO", alert.name, f"over after {(now_ns - began_ns) * 1e-9:.1f} s")
