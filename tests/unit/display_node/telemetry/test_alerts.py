"""Alerts of a status."""

from dataclasses import asdict, replace
from typing import Any

import pytest

from display_node.telemetry.alerts import alerts
from protocol.faults import START_AGAIN, Fault, FaultKind, Note, Part
from protocol.finger import FingerState, WithdrawalOutcome
from protocol.refusals import Reason
from protocol.summary.fields import BeatFigures, Compensation, Deadlines, Loop, Summary
from tests.support.given_faults import FILM_LOST, MISSED

SECOND_NS = 1_000_000_000
HOUR_NS = 3600 * SECOND_NS
Changes = dict[str, Any]


def refused(cause: str, state: str = "waiting") -> Changes:
    """Return the figures of a display that is refused, of which it waits in two states."""
    reasons = waiting_for(REFUSED) if state in ("waiting", "stale") else []
    return {"rejected": {cause: 4}, "refused": cause, "waiting_for": reasons}


def waiting_for(*reasons: Reason) -> list[dict[str, str]]:
    return Summary(waiting_for=list(reasons)).to_dict()["waiting_for"]


def faults(*found: Fault) -> Changes:
    return {"faults": [each.to_dict() for each in found]}


def notes(*found: Note) -> Changes:
    return {"notes": Summary(notes=list(found)).to_dict()["notes"]}


def late(loop: Loop) -> Changes:
    return {"loop": asdict(loop)}


def doubtful(**changes: Any) -> Changes:
    return {"beats": asdict(BeatFigures(**{"count": 22, "quality": 0.12, "alarm": True} | changes))}


def several(**contactors: Summary) -> Changes:
    return {"contactors": Summary(contactors=contactors).to_dict()["contactors"]}


NO_PULSE = (
    "the received signal is no regular pulse (quality 0.12): check the sensor's place and contact"
)
WRONG = (
    "the predicted force was off by more than 10 % of the pulse's height for {} of the last 5 s,"
    " which a finger notices"
)
STIFF = (
    "5.00 times the scene's fingertip, implausible for a finger: the film reads too much"
    " (telepulse calibrate) or the motor moves further than its step count says (telepulse bench)"
)
CHECK_FILM = f"check the film's sensor and its cable; {START_AGAIN}"
STALE = {"stale": "no samples to play"}
REFUSED = Reason(
    "tcp://127.0.0.1:5556 does not allow the key of finger",
    "there: telepulse keys allow finger.pub",
)
REFUSAL = str(REFUSED)
SAMPLES = waiting_for(Reason("samples"))
GUANS = replace(FILM_LOST, contactor="guan")
OFF = FingerState(0.0, 0.0, "", WithdrawalOutcome.WITHDRAWN, True)
TROUBLED = Summary(
    beats=BeatFigures(quality=0.12, alarm=True),
    compensation=Compensation(noticed_5s=0.123, alarm=True),
    finger=FingerState(0.245),
    finger_stiffness=5.0,
)
THREE = several(cun=Summary(), guan=TROUBLED, chi=Summary(finger=OFF, finger_stiffness=1.0))
FINGERS = "; finger: guan: pressed with 245 mN, chi: withdrawn"
# A display's state, changes of its summary, and the alerts, which terminal and page show alike.
ALERTS: list[tuple[str, Changes, dict[str, str]]] = [
    ("playing", {}, {}),
    (
        "fault",
        faults(FILM_LOST) | {"finger": asdict(FingerState(0.245))},
        {"fault: film: feedback lost": f"{CHECK_FILM}; finger: pressed with 245 mN"},
    ),
    (
        "fault",
        faults(GUANS) | several(cun=Summary(finger=OFF), guan=Summary()),
        {"fault: guan: film: feedback lost": f"{CHECK_FILM}; finger: cun: withdrawn"},
    ),
    ("playing", notes(MISSED), {"film's sensor": "3 samples missing"}),
    ("waiting", notes(Note(Part.RECORDER, "it is gone")), {"recorder": "it is gone"}),
    (
        "playing",
        notes(replace(MISSED, contactor="cun"), MISSED, Note(Part.SENSOR, "2 beyond 20 N")),
        {
            "film's sensor": "cun: 3 samples missing; 3 samples missing",
            "sensing node": "2 beyond 20 N",
        },
    ),
    ("stale", {}, STALE),
    ("stale", refused("revoked"), {"revoked": REFUSAL, **STALE}),
    ("waiting", refused("revoked"), {"revoked": REFUSAL}),
    ("playing", refused("revoked", "playing"), {}),
    # Refused earlier, and allowed since then.
    ("stale", refused("revoked") | {"refused": None, "waiting_for": SAMPLES}, STALE),
    ("waiting", refused("refused_key") | {"refused": None, "waiting_for": SAMPLES}, {}),
    ("waiting", refused("refused_key"), {"not connected": REFUSAL}),
    ("stale", refused("not_authentic"), {"not connected": REFUSAL, **STALE}),
    ("playing", refused("refused_key", "playing"), {}),
    ("waiting", {"rejected": {"session": 4}}, {}),
    ("waiting", {"rejected_readers": {"no_key": 9}}, {}),
    ("playing", doubtful(), {"pulse": NO_PULSE}),
    ("playing", doubtful(alarm=False), {}),
    # A pulse is judged while it is felt.
    ("stale", doubtful(), STALE),
    ("playing", {"compensation": asdict(Compensation(noticed_5s=0.04, alarm=False))}, {}),
    (
        "playing",
        {"compensation": asdict(Compensation(noticed_5s=0.123, alarm=True))},
        {"prediction": WRONG.format("12.3 %")},
    ),
    # Of a program that does not send the figure.
    ("playing", {"compensation": {"alarm": True}}, {"prediction": WRONG.format("too much")}),
    (
        "playing",
        late(Loop(3000, 411, late=True, last_5s=Deadlines(0.0822, 412.0))),
        {"deadline misses": "8.2 % of the ticks of the last 5 s missed, longest gap 412 ms"},
    ),
    ("playing", late(Loop(3000, 1, late=False)), {}),
    # Late ticks are no matter while nothing is felt.
    ("waiting", late(Loop(3000, 411, late=True)), {}),
    ("playing", {"finger_stiffness": 5.0}, {"finger's stiffness": STIFF}),
    (
        "playing",
        THREE,
        {
            "finger's stiffness: guan": STIFF,
            "pulse: guan": NO_PULSE,
            "prediction: guan": WRONG.format("12.3 %"),
        },
    ),
    (
        "stale",
        THREE,
        {
            "stale": f"no samples to play{FINGERS}",
            "finger's stiffness: guan": STIFF,
            "prediction: guan": WRONG.format("12.3 %"),
        },
    ),
]


@pytest.mark.parametrize(("state", "changes", "expected"), ALERTS)
def test_each_condition_has_its_alert_and_a_good_state_none(
    state: str, changes: Changes, expected: dict[str, str]
) -> None:
    found = alerts(state, Summary().to_dict() | changes)
    assert [(alert.name, alert.text) for alert in found] == list(expected.items())


def test_of_a_silent_display_only_faults_and_silence_are_alerts_and_of_the_last_status_faults() -> (
    None
):
    summary = Summary(faults=[FILM_LOST], finger=FingerState(None, 3.0)).to_dict()
    summary |= {"compensation": {"alarm": True}}
    found = alerts("fault", summary, silent_ns=4 * SECOND_NS)
    assert [(alert.name, alert.text) for alert in found] == [
        ("fault: film: feedback lost", CHECK_FILM),
        ("no telemetry", "since 4 s; finger: unknown, before that: force unknown since 3 s"),
    ]
    last = alerts("fault", summary, is_last_status=True, silent_ns=HOUR_NS)
    assert [alert.name for alert in last] == ["fault: film: feedback lost"]


def test_after_a_fault_no_alert_speaks_of_the_pulse() -> None:
    troubled = Summary(
        faults=[FILM_LOST],
        notes=[MISSED],
        contactors={"guan": TROUBLED, "cun": Summary()},
        loop=Loop(3000, 411, late=True),
    )
    for state in ("fault", "playing", "stale"):
        found = alerts(state, troubled.to_dict())
        assert [alert.name for alert in found] == ["fault: film: feedback lost", "film's sensor"]


def test_an_alert_stays_the_same_while_its_texts_change() -> None:
    def identity(found: Fault) -> object:
        (alert,) = alerts("fault", Summary(faults=[found]).to_dict())
        return alert.identity

    lost = identity(FILM_LOST)
    assert identity(replace(FILM_LOST, cause="feedback lost for 3 s", at_ns=7)) == lost
    others = (
        replace(FILM_LOST, contactor="guan"),
        replace(FILM_LOST, part=Part.DRIVE),
        replace(FILM_LOST, kind=FaultKind.LATE),
    )
    assert len({lost, *map(identity, others)}) == 4
