"""Alerts of a status, and its age by the stamps of the traces, where reader and display stall."""

from dataclasses import asdict
from typing import Any

import pytest

from display_node.fault_advice import FILM_NOTE
from display_node.telemetry.alerts import WINDOW_NS, StatusAge, alerts
from protocol.refusals import CAUSE_MEANINGS
from protocol.summary.tables import BeatFigures, Compensation, Deadlines, Loop, Summary

MS, SECOND_NS = 1_000_000, 1_000_000_000
HOUR_NS = 3600 * SECOND_NS
Changes = dict[str, Any]


def rejected(cause: str, count: int) -> Changes:
    return {"rejected": {cause: count}}


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
CHECK_FILM = "check the film's sensor and its cable; then start the display again"
STALE = {"stale": "no samples to play"}
TROUBLED = Summary(
    beats=BeatFigures(quality=0.12, alarm=True),
    compensation=Compensation(noticed_5s=0.123, alarm=True),
    finger="pressed with 245 mN",
    finger_stiffness=5.0,
)
THREE = several(cun=Summary(), guan=TROUBLED, chi=Summary(finger="withdrawn", finger_stiffness=1.0))
FINGERS = "; finger: guan: pressed with 245 mN, chi: withdrawn"
# A display's state, changes of its summary, and the alerts, which terminal and page show alike.
ALERTS: list[tuple[str, Changes, dict[str, str]]] = [
    ("playing", {}, {}),
    (
        "fault",
        {"faults": ["feedback lost"], "finger": "pressed with 245 mN"},
        {"fault: feedback lost": f"{CHECK_FILM}; finger: pressed with 245 mN"},
    ),
    (
        "fault",
        {"faults": ["guan: feedback lost"]} | several(cun=Summary(finger="off"), guan=Summary()),
        {"fault: guan: feedback lost": f"{CHECK_FILM}; finger: cun: off"},
    ),
    ("playing", {"faults": [f"{FILM_NOTE}3 missing"]}, {FILM_NOTE.removesuffix(": "): "3 missing"}),
    ("stale", {}, STALE),
    ("stale", rejected("revoked", 4), {"revoked": CAUSE_MEANINGS["revoked"], **STALE}),
    ("playing", rejected("revoked", 4), {}),
    *(
        (state, rejected(cause, count), {"not connected": f"{count} {cause}: {meaning}"} | also)
        for state, cause, count, also in (
            ("waiting", "refused_key", 1, {}),
            ("stale", "not_authentic", 319, STALE),
            ("waiting", "handshake", 3, {}),
        )
        for meaning in (CAUSE_MEANINGS[cause],)
    ),
    # A node that shuts down breaks a handshake or two.
    ("stale", rejected("handshake", 2), STALE),
    ("playing", rejected("refused_key", 9), {}),
    ("waiting", rejected("session", 4), {}),
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
    assert alerts(state, Summary().to_dict() | changes) == list(expected.items())


def test_of_a_silent_display_only_faults_and_silence_are_alerts_and_of_the_last_status_faults() -> (
    None
):
    summary = Summary(faults=["feedback lost"], finger="force unknown since 3 s").to_dict()
    summary |= {"compensation": {"alarm": True}}
    assert alerts("fault", summary, silent_ns=4 * SECOND_NS) == [
        ("fault: feedback lost", CHECK_FILM),
        ("no telemetry", "since 4 s; finger: unknown, before that: force unknown since 3 s"),
    ]
    last = alerts("fault", summary, is_last_status=True, silent_ns=HOUR_NS)
    assert [alert.name for alert in last] == ["fault: feedback lost"]


def receive(age: StatusAge, ahead_ns: int, from_ns: int, to_ns: int = 0, delay_ns: int = MS) -> int:
    """Receive trace and status every 100 ms until `to_ns`, from a clock `ahead_ns` ahead.

    Returns the time on the reader's clock at which the last ones were sent.
    """
    for now_ns in range(from_ns, to_ns or from_ns + 1, 100 * MS):
        age.take_trace(now_ns + ahead_ns, now_ns + delay_ns)
        age.take_status(now_ns + delay_ns)
    return now_ns


def test_without_a_stamp_the_age_counts_from_the_receipt() -> None:
    age, before_the_first_trace = StatusAge(), StatusAge()
    age.take_trace(0, 0)
    assert age.age_ns(HOUR_NS) is None
    before_the_first_trace.take_status(SECOND_NS)
    assert before_the_first_trace.age_ns(3 * SECOND_NS) == 2 * SECOND_NS


def test_on_this_machine_queued_telemetry_is_as_old_as_its_stamp() -> None:
    age = StatusAge(local=True)
    receive(age, 0, HOUR_NS, delay_ns=3 * SECOND_NS)
    assert age.age_ns(HOUR_NS + 3 * SECOND_NS) == 3 * SECOND_NS


@pytest.mark.parametrize("local", [True, False])
@pytest.mark.parametrize("ahead_ns", [-HOUR_NS, HOUR_NS])
def test_over_another_clock_age_is_beyond_the_shortest_transit(local: bool, ahead_ns: int) -> None:
    """The address of a tunnel is on this machine, the clock of its display is not."""
    age = StatusAge(local)
    last_ns = receive(age, ahead_ns, HOUR_NS, HOUR_NS + 2 * SECOND_NS, delay_ns=30 * MS)
    assert age.age_ns(last_ns + 30 * MS) == 0
    # The reader stalls for 5 s; the telemetry that it receives then has queued for 4 s.
    receive(age, ahead_ns, last_ns + SECOND_NS, delay_ns=4 * SECOND_NS)
    assert age.age_ns(last_ns + 5 * SECOND_NS) == 4 * SECOND_NS - 30 * MS


def test_a_trace_of_the_next_process_does_not_make_a_killed_ones_status_current() -> None:
    age = StatusAge(local=True)
    last_ns = receive(age, 0, HOUR_NS, HOUR_NS + SECOND_NS)
    back_ns = last_ns + 3 * SECOND_NS
    age.take_trace(back_ns, back_ns)
    assert age.age_ns(back_ns) == 3 * SECOND_NS


def test_drifting_clocks_do_not_age_the_newest_status() -> None:
    age = StatusAge()
    for step in range(0, 12 * HOUR_NS, 10 * SECOND_NS):
        receive(age, -step // 20_000, step, delay_ns=0)
        found_ns = age.age_ns(step)
        assert found_ns is not None
        assert found_ns <= 2 * WINDOW_NS // 20_000


def test_a_restart_of_the_displays_machine_resets_the_offset() -> None:
    age = StatusAge()
    last_ns = receive(age, HOUR_NS, HOUR_NS, HOUR_NS + SECOND_NS)
    back_ns = last_ns + 60 * SECOND_NS
    last_ns = receive(age, -back_ns, back_ns, back_ns + SECOND_NS)
    assert age.age_ns(last_ns + MS) == 0


def test_a_status_is_valid_while_traces_follow_it() -> None:
    """With ticks of 10 ms there is a status only every 2 s."""
    age = StatusAge(local=True)
    receive(age, 0, 0, delay_ns=0)
    for now_ns in range(200 * MS, 2_000 * MS, 200 * MS):
        assert age.age_ns(now_ns) == 200 * MS
        age.take_trace(now_ns, now_ns)
    # After a gap between traces it is not, whatever follows.
    age.take_trace(5 * SECOND_NS, 5 * SECOND_NS)
    age.take_trace(5_200 * MS, 5_200 * MS)
    assert age.age_ns(5_200 * MS) == 3_400 * MS
