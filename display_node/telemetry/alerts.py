"""Alerts for the person at a display, computed from one status message.

Terminal, live page and recordings share them. An alert is a record; its texts are made where it is
shown. Pure.
"""

from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from display_node.scoring.beat_statistics import pulse_alarm
from display_node.scoring.deadlines import deadline_alarm
from display_node.scoring.prediction_score import prediction_alarm
from protocol.faults import START_AGAIN, Fault, faults_of, notes_of, texts_by_part
from protocol.finger import describe_finger, finger_in
from protocol.refusals import REVOKED, Reason
from protocol.summary.fields import awaited_in, contactors_of

# A display without telemetry for this long counts as silent.
SILENT_AFTER_NS = 2_000_000_000
# States in which `waiting_for` has reasons.
WITHOUT_SAMPLES = ("waiting", "stale")
# Ratios to the scene's fingertip stiffness. Those of human fingers are 0.3 to 3, and the estimate
# is within 10 %, so a ratio beyond these bounds is not a finger's.
LEAST_STIFFNESS, MOST_STIFFNESS = 0.25, 4.0


class AlertKind(StrEnum):
    """Kind of an alert; the value is its name for people."""

    FAULT = "fault"
    NO_TELEMETRY = "no telemetry"
    FILM_SENSOR = "film's sensor"
    SENSING_NODE = "sensing node"
    RECORDER = "recorder"
    REVOKED = "revoked"
    NOT_CONNECTED = "not connected"
    STALE = "stale"
    STIFFNESS = "finger's stiffness"
    PULSE = "pulse"
    PREDICTION = "prediction"
    DEADLINES = "deadline misses"
    # These are found by a reader of the telemetry: live page or recorder.
    LINK_CUT = "link cut"
    REFUSED = "refused"
    READER_REFUSED = "reader refused"
    LIMITED = "limited"
    LOSS = "loss"
    CLOCK_STEP = "clock step"
    MISSED = "missed"


@dataclass(frozen=True, slots=True)
class Alert:
    """An alert."""

    kind: AlertKind
    #: What is wrong; of a fault, what to do. It may change while the alert lasts.
    reason: str
    #: What to do, and what is measured; left out where there is no room.
    further: tuple[str, ...] = ()
    #: The one of several contactors that it is about.
    contactor: str = ""
    fault: Fault | None = None

    @property
    def identity(self) -> Hashable:
        """Kind, contactor and fault, which stay the same while the alert lasts."""
        return self.kind, self.contactor, self.fault and self.fault.identity

    @property
    def subject(self) -> str:
        """Fault or contactor of the alert; empty where its kind has no other one."""
        return self.contactor if self.fault is None else str(self.fault)

    @property
    def name(self) -> str:
        """Kind and subject."""
        return f"{self.kind.value}: {self.subject}" if self.subject else self.kind.value

    @property
    def text(self) -> str:
        """Reason and remedy in full."""
        return "; ".join(filter(None, (self.reason, *self.further)))


def alerts(
    state: str, summary: Mapping[str, Any], is_last_status: bool = False, silent_ns: int = 0
) -> list[Alert]:
    """Return the alerts for a status, whose fields `state` and `summary` are.

    Once a fault is latched, nothing is felt: no alert speaks of the pulse. silent_ns: time without
    telemetry from the display. After 2 s of it, only latched faults and the silence are reported;
    for the last status of a display, only latched faults.
    """
    faults = faults_of(summary)
    silent = silent_ns > SILENT_AFTER_NS and not is_last_status
    finger = "" if silent else finger_note(summary)
    found = [
        Alert(AlertKind.FAULT, each.advice, (START_AGAIN, finger), fault=each) for each in faults
    ]
    if silent:
        known = finger_text(summary)
        before = f", before that: {known}" if known else ""
        further = (f"finger: unknown{before}",)
        found.append(Alert(AlertKind.NO_TELEMETRY, f"since {silent_ns * 1e-9:.0f} s", further))
    if silent or is_last_status:
        return found
    found += _noted(summary)
    if faults:
        return found
    if state in WITHOUT_SAMPLES and (refused := summary.get("refused")):
        kind = AlertKind.REVOKED if refused == REVOKED else AlertKind.NOT_CONNECTED
        first, *others = awaited_in(summary) or [Reason("")]
        found.append(Alert(kind, first.text, (first.further, *map(str, others))))
    if state == "stale":
        found.append(Alert(AlertKind.STALE, "no samples to play", (finger,)))
    for name, figures in contactors_of(summary).items():
        found += _of_contactor(state, name, figures)
    # Late ticks are felt only while a pulse is played.
    plays = state in ("playing", "starting")
    late = deadline_alarm(summary.get("loop", {})) if plays else None
    return found if late is None else [*found, Alert(AlertKind.DEADLINES, late)]


def _noted(summary: Mapping[str, Any]) -> Iterator[Alert]:
    """Yield the alerts of the films' sensors, of the sensing node, and of the recorder."""
    kinds = AlertKind.FILM_SENSOR, AlertKind.SENSING_NODE, AlertKind.RECORDER
    for kind, texts in zip(kinds, texts_by_part(notes_of(summary)), strict=True):
        if texts:
            yield Alert(kind, texts[0], tuple(texts[1:]))


def _of_contactor(state: str, name: str, figures: Mapping[str, Any]) -> Iterator[Alert]:
    """Yield the alerts of a contactor's figures."""
    stiffness = figures.get("finger_stiffness")
    if stiffness is not None and not LEAST_STIFFNESS <= stiffness <= MOST_STIFFNESS:
        film, motor = ("little", "less") if stiffness < 1 else ("much", "further")
        yield Alert(
            AlertKind.STIFFNESS,
            f"{stiffness:.2f} times the scene's fingertip, implausible for a finger: the film"
            f" reads too {film} (telepulse calibrate) or the motor moves {motor} than its step"
            " count says (telepulse bench)",
            contactor=name,
        )
    alarms = {
        AlertKind.PULSE: pulse_alarm(figures.get("beats", {})) if state == "playing" else None,
        AlertKind.PREDICTION: prediction_alarm(figures.get("compensation", {})),
    }
    for kind, text in alarms.items():
        if text is not None:
            yield Alert(kind, text, contactor=name)


def waiting_texts(state: str, summary: Mapping[str, Any]) -> list[str]:
    """Return what belongs beside the state of a display that waits, one text for each address.

    Beside the state it is what the display waits for. A refusal is an alert instead, which shows
    its reason and its remedy in full.
    """
    if state not in WITHOUT_SAMPLES or summary.get("refused"):
        return []
    return [reason.text for reason in awaited_in(summary)]


def finger_text(summary: Mapping[str, Any]) -> str:
    """Return the state of each finger, of several with the contactor's name; empty if unknown."""
    fingers = {
        name: describe_finger(finger_in(figures))
        for name, figures in contactors_of(summary).items()
    }
    found = (f"{name}: {text}" if name else text for name, text in fingers.items() if text)
    return ", ".join(found)


def finger_note(summary: Mapping[str, Any]) -> str:
    """Return "finger: …", or an empty string where the status has no state of the finger."""
    finger = finger_text(summary)
    return f"finger: {finger}" if finger else ""


def delay_note(delay_ms: float, trusted: bool, summary: Mapping[str, Any]) -> tuple[str, str]:
    """Return the present playout delay, and the predictor's trust where trust is used."""
    trust = f"prediction {'' if trusted else 'not '}trusted"
    trust_is_used = summary.get("compensation", {}).get("trusted") is not None
    # An E of 0 is known to the clock's error only.
    return f"{max(delay_ms, 0.0):.1f} ms", trust if trust_is_used else ""
