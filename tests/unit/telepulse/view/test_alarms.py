import pytest

from protocol.counters import Limited, Limits
from protocol.summary_tables import Clock, Deadlines, Loop, SampleCounts
from telepulse.view.live import LiveState
from telepulse.view.text import alarms
from tests.support.page_states import AHEAD_NS, MS, SECOND_NS, SimulatedDisplay

LATE = Loop(3000, 411, late=True, last_5s=Deadlines(0.0822, 412.0))


def names(display: SimulatedDisplay, silent_ns: int = 0) -> list[str]:
    return [alarm.name for alarm in alarms(display.live, silent_ns)]


@pytest.fixture
def display() -> SimulatedDisplay:
    display = SimulatedDisplay(LiveState())
    display.go(3)
    return display


def test_all_is_well_while_it_plays(display: SimulatedDisplay) -> None:
    assert names(display) == []


def test_a_cut_link_is_an_alarm_until_frames_come_again(display: SimulatedDisplay) -> None:
    display.linked = False
    display.go(0.6, "stale")
    assert names(display) == ["stale"]
    display.go(0.6, "stale")
    assert names(display) == ["stale", "link cut"]
    display.linked = True
    display.go(0.4)
    assert names(display) == []


def test_a_stream_that_has_ended_is_no_cut_link(display: SimulatedDisplay) -> None:
    display.event("end of stream", "4000 samples were sent")
    display.linked = False
    display.go(3, "ended")
    assert names(display) == []


def test_a_fault_is_an_alarm_by_its_name_and_stays_at_the_end(display: SimulatedDisplay) -> None:
    display.status("fault", faults=["feedback lost"])
    assert "fault: feedback lost" in names(display)
    display.status("fault", final=True, faults=["feedback lost"])
    assert names(display, silent_ns=60 * SECOND_NS) == ["fault: feedback lost"]


def test_a_display_that_falls_silent_is_an_alarm(display: SimulatedDisplay) -> None:
    assert names(display, silent_ns=3 * SECOND_NS) == ["no telemetry"]
    display.status("ended", final=True)
    assert names(display, silent_ns=3 * SECOND_NS) == []


def test_a_fault_is_shown_with_what_to_do_and_the_finger(
    display: SimulatedDisplay,
) -> None:
    display.status("fault", faults=["feedback lost"], finger="force unknown since 3 s")
    (alarm,) = alarms(display.live, 0)
    assert alarm.text == (
        "check the film's sensor and its cable; then start the display again;"
        " finger: force unknown since 3 s"
    )
    latched, silent = alarms(display.live, silent_ns=4 * SECOND_NS)
    assert "finger" not in latched.text
    assert silent.text == "since 4 s; finger: unknown, before that: force unknown since 3 s"


def test_a_revoked_display_is_an_alarm(display: SimulatedDisplay) -> None:
    display.status("stale", rejected={"revoked": 2})
    assert {"stale", "revoked", "refused"} == set(names(display))
    display.status("playing", rejected={"revoked": 2})
    assert "revoked" not in names(display)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("deadline misses", {"loop": LATE}),
        ("refused", {"rejected": {"malformed": 3}}),
        ("limited", {"limited": Limits(force=Limited(3, 1.5, 0.1))}),
        ("loss", {"samples": SampleCounts(4000, 3000, 300, 700, 0)}),
    ],
)
def test_a_count_that_rises_is_an_alarm_for_a_while(
    display: SimulatedDisplay, name: str, changes: dict[str, object]
) -> None:
    fields = {
        key: value if isinstance(value, dict) else _dict(value) for key, value in changes.items()
    }
    display.status("playing", **fields)
    assert names(display) == [name]
    lasting = {key: value for key, value in fields.items() if key == "rejected"}
    for _ in range(30):
        display.at_ns += 200 * MS
        display.frame()
        display.played += 200
        display.live.now_ns += 200 * MS
        display.status("playing", **lasting)
    assert names(display) == []


def test_single_deadline_misses_are_counted_and_no_alarm(display: SimulatedDisplay) -> None:
    display.status("playing", loop=_dict(Loop(3000, 1, late=False)))
    assert names(display) == []


def test_the_deadline_alarm_names_the_rate_and_the_longest_gap(display: SimulatedDisplay) -> None:
    display.status("playing", loop=_dict(LATE))
    (alarm,) = alarms(display.live, 0)
    assert alarm.text == "8.2 % of the ticks of the last 5 s missed, longest gap 412 ms"


@pytest.mark.parametrize("name", ["clock step", "missed"])
def test_a_single_occurrence_is_shown_for_five_seconds(
    display: SimulatedDisplay, name: str
) -> None:
    display.event(name, "it happened", "WARNING")
    assert names(display) == [name]
    display.go(5.1)
    assert names(display) == []


def test_a_clock_that_is_ahead_by_more_is_no_alarm_of_its_own(display: SimulatedDisplay) -> None:
    display.status("playing", clock=_dict(Clock(AHEAD_NS / MS + 1, 3.0, 0.05, 0.1, 0)))
    assert names(display) == []


def _dict(part: object) -> dict[str, object]:
    import dataclasses

    return dataclasses.asdict(part)  # type: ignore[call-overload, no-any-return]
