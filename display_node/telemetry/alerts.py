"""Alerts for the person at a display, from a status alone: terminal and page share them."""

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
