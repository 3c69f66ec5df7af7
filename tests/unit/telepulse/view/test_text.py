from dataclasses import asdict
from typing import Any

import pytest

from protocol.refusals import Reason
from protocol.summary.fields import Deadlines, Limited, Limits, Loop, SampleCounts
from protocol.summary.figures import figures as summary_figures
from telepulse.telemetry.events import REFUSALS
from telepulse.view.live import LiveState
from telepulse.view.text import ALARMS_UNKNOWN, FIGURES, age, alarms, calm, figures, state
from telepulse.view.window_data import Scores, window_scores
from tests.support.given_faults import FILM_LOST
from tests.unit.display_node.telemetry.test_alerts import ALERTS, REFUSAL, REFUSED, waiting_for
from tests.unit.telepulse.view.page_states import SECOND_NS, SimulatedDisplay

LATE = Loop(3000, 411, late=True, last_5s=Deadlines(0.0822, 412.0))


@pytest.fixture
def display() -> SimulatedDisplay:
    display = SimulatedDisplay(LiveState())
    display.go(6)
    return display


def names(display: SimulatedDisplay, silent_ns: int = 0) -> list[str]:
    return [alarm.name for alarm in alarms(display.live, silent_ns)]


def texts(display: SimulatedDisplay) -> list[tuple[str, str]]:
    return [(alarm.name, alarm.text) for alarm in alarms(display.live, 0)]


def test_an_unknown_figure_is_a_dash() -> None:
    live = LiveState()
    shown = figures(live, window_scores(live, SECOND_NS))
    assert shown.keys() == FIGURES.keys()
    assert {figure.value for figure in shown.values()} == {"–"}
    assert state(live) == ("waiting", "no telemetry from a display yet")


def test_no_alarm_is_shown_once_the_display_has_sent_its_state(display: SimulatedDisplay) -> None:
    assert calm(LiveState()) == (False, ALARMS_UNKNOWN)
    assert calm(display.live) == (True, "No alarm.")


def test_force_and_delay_are_shown_while_the_pulse_is_felt(display: SimulatedDisplay) -> None:
    for word, force, delay in (("playing", "900 of 900 mN", "40.0 ms"), ("stale", "–", "–")):
        display.go(0.2, word)
        shown = figures(display.live, window_scores(display.live, SECOND_NS))
        assert (shown["force"].value, shown["delay"].value) == (force, delay)


def test_old_figures_have_their_age_and_no_heart_rate(display: SimulatedDisplay) -> None:
    now, late = 0, 2_300_000_000
    assert (age(display.live, now), age(display.live, late)) == ("", "2.3 s ago")
    assert state(display.live, now) == ("playing", "the pulse is felt")
    assert state(display.live, late) == ("playing", "2.3 s ago")
    shown = window_scores(display.live, SECOND_NS)
    assert figures(display.live, shown, now)["heart"].value == "75 /min"
    assert figures(display.live, shown, late)["heart"].value == "–"
    display.status("ended", final=True)
    assert age(display.live, late) == ""


def test_an_error_is_also_shown_as_a_share_of_what_it_is_judged_by(
    display: SimulatedDisplay,
) -> None:
    scores = Scores(2e-3, 9e-3, 1.0, jnd_n=6e-3, judged=1.0)
    shown = window_scores(display.live, SECOND_NS)._replace(scores=scores, all_scores=(scores,))
    note = "of the last 1 s, 3.3 % of the pulse's peak to peak"
    assert figures(display.live, shown)["aligned"] == ("2.000 mN", note)


def test_old_errors_have_the_time_at_which_their_window_ended(display: SimulatedDisplay) -> None:
    shown = window_scores(display.live, SECOND_NS)
    old = figures(display.live, shown, silent_ns=125 * SECOND_NS)
    for id in ("aligned", "in_phase"):
        assert old[id].note.startswith("of the 1 s until 125.0 s ago, ")
    judged = "of the 100.0 % of the 1 s until 125.0 s ago that could be judged"
    assert old["within"].note == f"a finger notices an error for 0.0 % of the time, {judged}"
    # The last figures of a display that has ended do not grow older.
    display.status("ended", final=True)
    ended = figures(display.live, shown, silent_ns=125 * SECOND_NS)
    assert ended["aligned"].note.startswith("of the last 1 s, ")


def test_a_refusal_is_an_alarm_and_another_reason_is_beside_the_state(
    display: SimulatedDisplay,
) -> None:
    connecting = waiting_for(Reason("connecting to tcp://wrist:5555"))
    display.status("waiting", waiting_for=connecting)
    assert state(display.live) == ("waiting", "connecting to tcp://wrist:5555")
    display.status("waiting", waiting_for=waiting_for(REFUSED), refused="refused_key")
    assert state(display.live) == ("waiting", "for the sensing node")
    assert ("not connected", REFUSAL) in texts(display)


def test_the_last_state_is_marked_as_the_last(display: SimulatedDisplay) -> None:
    assert state(display.live)[0] == "playing"
    display.status("playing", final=True)
    word, note = state(display.live)
    assert word == "ended"
    assert "last state" in note
    display.status("fault", final=True, faults=[FILM_LOST.to_dict()])
    assert state(display.live)[0] == "fault"


@pytest.mark.parametrize(("state", "changes", "expected"), ALERTS)
def test_each_alert_is_an_alarm_and_a_good_state_has_none(
    display: SimulatedDisplay, state: str, changes: dict[str, Any], expected: dict[str, str]
) -> None:
    display.status(state, **changes)
    assert [each for each in texts(display) if each[0] not in REFUSALS.values()] == list(
        expected.items()
    )


def test_a_cut_link_is_an_alarm_until_frames_come_again(display: SimulatedDisplay) -> None:
    display.linked = False
    display.go(0.6, "stale")
    assert names(display) == ["stale"]
    display.go(0.6, "stale")
    assert names(display) == ["stale", "link cut"]
    display.linked = True
    display.go(0.4)
    assert names(display) == []


def test_silence_is_an_alarm_until_the_stream_or_the_display_has_ended(
    display: SimulatedDisplay,
) -> None:
    assert names(display, silent_ns=3 * SECOND_NS) == ["no telemetry"]
    display.event("end of stream", "4000 samples were sent")
    display.linked = False
    display.go(3, "ended")
    assert names(display) == []
    display.status("ended", final=True)
    assert names(display, silent_ns=3 * SECOND_NS) == []


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("deadline misses", {"loop": asdict(LATE)}),
        ("refused", {"rejected": {"malformed": 3}}),
        ("reader refused", {"rejected_readers": {"no_key": 3}}),
        ("limited", {"limited": asdict(Limits(force=Limited(3, 1.5, 0.1)))}),
        ("loss", {"samples": asdict(SampleCounts(7000, 2000, 4000, 300, 700, 0))}),
    ],
)
def test_a_count_that_rises_is_an_alarm_for_a_while(
    display: SimulatedDisplay, name: str, changes: dict[str, Any]
) -> None:
    display.status("playing", **changes)
    assert names(display) == [name]
    kept = {key: changes[key] for key in ("rejected", "rejected_readers") if key in changes}
    display.go(6, **kept)
    assert names(display) == []


def test_predicted_samples_are_no_loss_and_no_alarm(display: SimulatedDisplay) -> None:
    counts = SampleCounts(sent=7000, played=6000, predicted=995, late=2, lost=3)
    display.status("playing", samples=asdict(counts))
    shown = figures(display.live, window_scores(display.live, SECOND_NS))
    assert shown["loss"].note.endswith("the display started: 3 samples lost, 2 late, 995 predicted")
    assert names(display) == []


def test_the_loss_is_of_the_window_and_its_counts_say_since_when() -> None:
    display = SimulatedDisplay(LiveState())
    display.go(6)
    losing = {"samples": asdict(SampleCounts(6500, 6000, 0, 100, 400, 0))}
    display.status("playing", **losing)
    counts = "since the display started: 400 samples lost, 100 late, 0 predicted"
    # In the last second, 1000 of 1500 samples were played.
    for seconds, share in ((1, "33.33 %"), (60, "7.69 %")):
        shown = figures(display.live, window_scores(display.live, seconds * SECOND_NS))
        assert shown["loss"] == (share, f"of the last {seconds} s; {counts}")
    display.go(3, samples=losing["samples"])
    shown = figures(display.live, window_scores(display.live, SECOND_NS))
    assert shown["loss"] == ("–", f"of the last 1 s; {counts}")


@pytest.mark.parametrize("name", ["clock step", "missed"])
def test_a_single_occurrence_is_shown_for_5_seconds(display: SimulatedDisplay, name: str) -> None:
    display.event(name, "it happened", "WARNING")
    for seconds, shown in ((0, [name]), (4.9, [name]), (0.2, [])):
        display.go(seconds)
        assert names(display) == shown


def test_an_error_is_shown_without_a_share_where_the_pulse_is_constant() -> None:
    # A constant force has no peak to peak.
    scores = Scores(1.25e-3, 2e-3, None, 0.0, 1.0)
    live = LiveState()
    empty = window_scores(live, SECOND_NS)
    shown = figures(live, empty._replace(scores=scores, all_scores=(scores,)))
    assert shown["aligned"] == ("1.250 mN", "of the last 1 s")
    assert shown["in_phase"].value == "2.000 mN"
    assert shown["within"].value == "–"


def test_errors_of_the_window_are_not_named_like_those_of_the_whole_run() -> None:
    names = {figure.name for figure in summary_figures()}
    assert names >= {"force RMSE, aligned", "force RMSE, in phase", "within JND"}
    assert not names & {FIGURES[id] for id in ("aligned", "in_phase", "within")}
