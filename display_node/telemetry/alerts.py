"""Alerts for the person at a display, computed from one status message, and the age of a status.

Terminal, live page and metrics share them. Pure.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from display_node.fault_advice import FILM_NOTE, SENSING_NOTE, advise, latched
from display_node.scoring.beat_statistics import pulse_alarm
from display_node.scoring.deadlines import deadline_alarm
from display_node.scoring.prediction_score import prediction_alarm
from protocol.refusals import (
    CAUSE_MEANINGS,
    HANDSHAKE,
    NO_KEY,
    NOT_AUTHENTIC,
    REFUSED_KEY,
    REPLAYED,
    REVOKED,
    explain_causes,
)
from protocol.security.socket_monitor import REPEATED_BREAKS
from protocol.summary.tables import contactors_of

# A display without telemetry for this long counts as silent.
SILENT_AFTER_NS = 2_000_000_000
NOT_CONNECTED, STIFFNESS = "not connected", "finger's stiffness"
# Ratios to the scene's fingertip stiffness. Those of human fingers are 0.3 to 3, and the estimate
# is within 10 %, so a ratio beyond these bounds is not a finger's.
LEAST_STIFFNESS, MOST_STIFFNESS = 0.25, 4.0
# Counts from which a link counts as refused; HANDSHAKE needs several, since a node that shuts down
# also breaks the handshake.
CONNECTION_CAUSES = dict.fromkeys((REFUSED_KEY, NO_KEY, NOT_AUTHENTIC, REPLAYED), 1)
CONNECTION_CAUSES[HANDSHAKE] = REPEATED_BREAKS


class Alert(NamedTuple):
    """An alert. `name` stays the same while it lasts; `text` may change, e.g. a counter in it."""

    name: str
    text: str


def alerts(
    state: str, summary: Mapping[str, Any], is_last_status: bool = False, silent_ns: int = 0
) -> list[Alert]:
    """Return the alerts for a status, whose fields `state` and `summary` are.

    Of several contactors, the alerts of one have its name after theirs: "pulse: cun". silent_ns:
    time without telemetry from the display. After 2 s of it, only latched faults and the silence
    are reported; for the last status of a display, only latched faults.
    """
    faults, rejected = summary.get("faults", []), summary.get("rejected", {})
    silent = silent_ns > SILENT_AFTER_NS and not is_last_status
    finger = "" if silent else finger_note(summary)
    found = [Alert(f"fault: {fault}", f"{advise(fault)}{finger}") for fault in latched(faults)]
    if silent:
        known = finger_text(summary)
        before = f", before that: {known}" if known else ""
        text = f"since {silent_ns * 1e-9:.0f} s; finger: unknown{before}"
        found.append(Alert("no telemetry", text))
    if silent or is_last_status:
        return found
    for prefix in (FILM_NOTE, SENSING_NOTE):
        notes = [fault.removeprefix(prefix) for fault in faults if fault.startswith(prefix)]
        if notes:
            found.append(Alert(prefix.removesuffix(": "), "; ".join(notes)))
    if rejected.get(REVOKED) and state != "playing":
        found.append(Alert("revoked", CAUSE_MEANINGS[REVOKED]))
    refused = {
        cause: rejected[cause]
        for cause, least in CONNECTION_CAUSES.items()
        if rejected.get(cause, 0) >= least
    }
    if refused and state in ("waiting", "stale"):
        found.append(Alert(NOT_CONNECTED, "; ".join(explain_causes(refused))))
    if state == "stale":
        found.append(Alert("stale", f"no samples to play{finger}"))
    for name, figures in contactors_of(summary).items():
        of = f": {name}" if name else ""
        found += [Alert(kind + of, text) for kind, text in _of_contactor(state, figures)]
    # Late ticks are felt only while a pulse is played.
    plays = state in ("playing", "starting")
    late = deadline_alarm(summary.get("loop", {})) if plays else None
    return found if late is None else [*found, Alert("deadline misses", late)]


def _of_contactor(state: str, figures: Mapping[str, Any]) -> Iterator[Alert]:
    """Yield the alerts of a contactor's figures."""
    stiffness = figures.get("finger_stiffness")
    if stiffness is not None and not LEAST_STIFFNESS <= stiffness <= MOST_STIFFNESS:
        film, motor = ("little", "less") if stiffness < 1 else ("much", "further")
        yield Alert(
            STIFFNESS,
            f"{stiffness:.2f} times the scene's fingertip, implausible for a finger: the film"
            f" reads too {film} (telepulse calibrate) or the motor moves {motor} than its step"
            " count says (telepulse bench)",
        )
    alarms = {
        "pulse": pulse_alarm(figures.get("beats", {})) if state == "playing" else None,
        "prediction": prediction_alarm(figures.get("compensation", {})),
    }
    yield from (Alert(name, text) for name, text in alarms.items() if text is not None)


def finger_text(summary: Mapping[str, Any]) -> str:
    """Return the state of each finger, of several with the contactor's name; empty if unknown."""
    fingers = {name: figures.get("finger") for name, figures in contactors_of(summary).items()}
    found = (f"{name}: {text}" if name else text for name, text in fingers.items() if text)
    return ", ".join(found)


def finger_note(summary: Mapping[str, Any]) -> str:
    """Return "; finger: …", or an empty string where the status has no state of the finger."""
    finger = finger_text(summary)
    return f"; finger: {finger}" if finger else ""


def delay_note(delay_ms: float, trusted: bool, summary: Mapping[str, Any]) -> str:
    """Return the present playout delay, with the predictor's trust where trust is used."""
    trust = f", prediction {'' if trusted else 'not '}trusted"
    trust_is_used = summary.get("compensation", {}).get("trusted") is not None
    # An E of 0 is known to the clock's error only.
    return f"{max(delay_ms, 0.0):.1f} ms{trust if trust_is_used else ''}"


# The shortest transit is searched in windows of this length. Longer ones would add the clocks'
# drift against each other, some 50 µs/s.
WINDOW_NS = 60_000_000_000
# A display on this machine stamps with this machine's clock, unless the address is that of a tunnel
# to another machine. Telemetry that seems older than this, or newer than now, has another clock.
LONGEST_QUEUED_NS = 10_000_000_000
# A larger gap between two traces is a stall, or the start of another process.
BREAK_NS = 500_000_000


class StatusAge:
    """Age of the newest status of one display: the time since it was last known to be valid.

    Telemetry may queue while its reader or its display stalls. So the age counts from the display's
    time stamp, not from the receipt. A status has no stamp: it takes that of the trace before it.
    Each later trace extends its validity, up to the first gap between traces. The clock of another
    machine has an unknown offset, estimated by the shortest transit of the last one to two minutes.

    local: whether the display's address is on this machine.
    """

    def __init__(self, local: bool = False) -> None:
        self._local = local
        # Stamps of the newest trace, and of the last one at which the newest status was valid.
        self._stamped_ns: int | None = None
        self._status_ns: int | None = None
        # Smallest receipt minus stamp, in the present window and in the one before.
        self._least_ns: int | None = None
        self._before_ns: int | None = None
        self._window_ends_ns = 0
        self._received_ns: int | None = None

    def take_trace(self, stamped_ns: int, received_ns: int) -> None:
        """Take a trace whose newest tick is stamped `stamped_ns`."""
        if self._stamped_ns is not None and stamped_ns < self._stamped_ns:
            # The clock went back: the display's machine was restarted.
            self._least_ns = self._before_ns = self._status_ns = None
        elif (
            self._status_ns == self._stamped_ns is not None
            and stamped_ns - self._stamped_ns <= BREAK_NS
        ):
            self._status_ns = stamped_ns
        self._stamped_ns = stamped_ns
        difference_ns = received_ns - stamped_ns
        if received_ns >= self._window_ends_ns:
            self._window_ends_ns = received_ns + WINDOW_NS
            self._before_ns, self._least_ns = self._least_ns, difference_ns
        elif self._least_ns is None or difference_ns < self._least_ns:
            self._least_ns = difference_ns

    def take_status(self, received_ns: int) -> None:
        """Take a status."""
        self._status_ns, self._received_ns = self._stamped_ns, received_ns

    def age_ns(self, now_ns: int) -> int | None:
        """Return the age of the newest status at `now_ns` in ns; None before the first one."""
        if self._received_ns is None:
            return None
        if self._status_ns is None:
            return max(0, now_ns - self._received_ns)
        # This clock minus the display's, plus the shortest transit; 0 where they share one clock.
        known_ns = [ns for ns in (self._least_ns, self._before_ns) if ns is not None]
        offset_ns = min(known_ns, default=0)
        if self._local and 0 <= offset_ns <= LONGEST_QUEUED_NS:
            offset_ns = 0
        return max(0, now_ns - self._status_ns - offset_ns)
