"""Alerts for the person at a display, from a status alone, and the age of that status.

Terminal, page and metrics share them. Pure.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

from display_node.fault_advice import FILM_NOTE, SENSING_NOTE, advise, latched
from display_node.scoring.deadlines import deadline_alarm
from protocol.errors import CAUSE_MEANINGS, explain_causes
from protocol.security.socket_monitor import (
    BREAKS,
    HANDSHAKE,
    NO_KEY,
    NOT_AUTHENTIC,
    REFUSED_KEY,
    REPLAYED,
    REVOKED,
)

# Without telemetry for so long a display is taken for silent.
SILENT_AFTER_NS = 2_000_000_000
NOT_CONNECTED, STIFFNESS = "not connected", "finger's stiffness"
# Of the scene's fingertip: people's fingers are within 0.3 to 3, and the estimate within 10 %.
LEAST_STIFFNESS, MOST_STIFFNESS = 0.25, 4.0
# Counts from which a link is taken for refused; a node that ends breaks off, too.
CONNECTION_CAUSES = {REFUSED_KEY: 1, NO_KEY: 1, NOT_AUTHENTIC: 1, REPLAYED: 1, HANDSHAKE: BREAKS}


class Alert(NamedTuple):
    """name stays the same as long as the alert lasts; text may count."""

    name: str
    text: str


def alerts(
    state: str, summary: Mapping[str, Any], final: bool = False, silent_ns: int = 0
) -> list[Alert]:
    """Return what is wrong by a status.

    Parameters
    ----------
    state, summary, final
        Of the status. After the last one only what is latched is wrong still.
    silent_ns
        For how long nothing came from the display, in ns. After 2 s nothing that may have changed
        meanwhile is claimed any more.
    """
    faults, rejected = summary.get("faults", []), summary.get("rejected", {})
    silent = silent_ns > SILENT_AFTER_NS and not final
    finger = "" if silent else finger_note(summary)
    found = [Alert(f"fault: {fault}", f"{advise(fault)}{finger}") for fault in latched(faults)]
    if silent:
        known = summary.get("finger")
        before = f", before that: {known}" if known else ""
        text = f"since {silent_ns * 1e-9:.0f} s; finger: unknown{before}"
        return [*found, Alert("no telemetry", text)]
    if final:
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
    stiffness = summary.get("finger_stiffness")
    if stiffness is not None and not LEAST_STIFFNESS <= stiffness <= MOST_STIFFNESS:
        film, motor = ("little", "less") if stiffness < 1 else ("much", "further")
        found.append(
            Alert(
                STIFFNESS,
                f"{stiffness:.2f} times the scene's fingertip, implausible for a finger: the film"
                f" reads too {film} (telepulse calibrate) or the motor goes {motor} than it counts"
                " (telepulse bench)",
            )
        )
    late = deadline_alarm(summary.get("loop", {}))
    return found if late is None else [*found, Alert("deadline misses", late)]


def finger_note(summary: Mapping[str, Any]) -> str:
    """Return the display's sentence about the finger as an addition; empty where it has none."""
    finger = summary.get("finger")
    return f"; finger: {finger}" if finger else ""


# Of how long ago the shortest transit is used: two clocks drift by some 50 µs/s against each other.
WINDOW_NS = 60_000_000_000
# A display on this machine stamps by this machine's clock, unless the address leads through a
# tunnel. Telemetry that seems to be older than this, or of the future, has another clock.
LONGEST_QUEUED_NS = 10_000_000_000
# Traces further apart have a stall between them, or the start of another process.
BREAK_NS = 500_000_000


class TelemetryAge:
    """Age of the newest status of one display, as of the last time when it held.

    Telemetry may have queued while its reader or its display stood still, so its age counts from
    the display's stamp and not from its receipt. A status has no stamp: it follows a trace of the
    same tick, and holds until the newest of the traces that follow without a break. The clock of
    another machine has an unknown offset: there, the age counts from the earliest receipt that the
    shortest transit of the last one to two minutes allows. local: the address is on this machine.
    """

    def __init__(self, local: bool = False) -> None:
        self._local = local
        # The newest trace, and the one until which the newest status holds.
        self._stamped_ns: int | None = None
        self._status_ns: int | None = None
        # Least difference of receipt and stamp, in the present window and in the one before.
        self._least_ns: int | None = None
        self._before_ns: int | None = None
        self._window_ends_ns = 0
        self._received_ns: int | None = None

    def take_trace(self, stamped_ns: int, received_ns: int) -> None:
        """Take a trace whose newest tick is stamped `stamped_ns`."""
        if self._stamped_ns is not None and stamped_ns < self._stamped_ns:
            # Another clock: its machine was started again.
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
        # This clock less the display's, with the shortest transit where it is another.
        known = [least for least in (self._least_ns, self._before_ns) if least is not None]
        offset_ns = min(known, default=0)
        if self._local and 0 <= offset_ns <= LONGEST_QUEUED_NS:
            offset_ns = 0
        return max(0, now_ns - self._status_ns - offset_ns)
