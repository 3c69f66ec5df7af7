"""Alerts for the person at a display, computed from one status message.

Terminal, live page and recordings share them. Pure.
"""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from display_node.fault_advice import FILM_NOTE, SENSING_NOTE, advise, latched
from display_node.scoring.beat_statistics import pulse_alarm
from display_node.scoring.deadlines import deadline_alarm
from display_node.scoring.prediction_score import prediction_alarm
from protocol.refusals import REVOKED
from protocol.summary.fields import contactors_of

# A display without telemetry for this long counts as silent.
SILENT_AFTER_NS = 2_000_000_000
NOT_CONNECTED, STIFFNESS = "not connected", "finger's stiffness"
# States in which `waiting_for` has a text.
WITHOUT_SAMPLES = ("waiting", "stale")
# Ratios to the scene's fingertip stiffness. Those of human fingers are 0.3 to 3, and the estimate
# is within 10 %, so a ratio beyond these bounds is not a finger's.
LEAST_STIFFNESS, MOST_STIFFNESS = 0.25, 4.0


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
    faults = summary.get("faults", [])
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
    if state in WITHOUT_SAMPLES and (refused := summary.get("refused")):
        name = "revoked" if refused == REVOKED else NOT_CONNECTED
        found.append(Alert(name, summary.get("waiting_for") or ""))
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


def waiting_text(state: str, summary: Mapping[str, Any]) -> str:
    """Return the text that belongs beside the state of a display that waits; empty without one.

    Beside the state it is what the display waits for. A refusal is an alert instead, which shows
    its reason and its remedy in full.
    """
    if state not in WITHOUT_SAMPLES or summary.get("refused"):
        return ""
    return summary.get("waiting_for") or ""


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
