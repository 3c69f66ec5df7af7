from dataclasses import asdict

from protocol.availability import Availability
from protocol.limits import Limited, Limits
from telepulse.view.live import LiveState
from telepulse.view.picture import picture
from telepulse.view.text import FIGURES, age, figures, state
from tests.support.page_states import SECOND_NS, Told


def test_what_is_not_known_is_a_dash() -> None:
    live = LiveState()
    said = figures(live, picture(live, SECOND_NS))
    assert said.keys() == FIGURES.keys()
    assert {figure.value for figure in said.values()} == {"–"}
    assert state(live) == ("waiting", "no telemetry from a display yet")


def test_figures_have_their_units() -> None:
    told = Told(LiveState())
    told.go(6)
    # A display of another host, that runs for an hour and a half less.
    said = figures(told.live, picture(told.live, 5 * SECOND_NS))
    values = {name: figure.value for name, figure in said.items()}
    assert values["heart"] == "75 /min"
    assert values["within"] == "100.0 %"
    assert values["loss"] == "0.00 %"
    assert values["clock"] == "offset 5000.000 s"
    assert said["clock"].note.startswith("skew 3.0 ppm")
    assert values["predictor"] == "ensemble"
    assert said["loop"] == ("0 deadline misses", "1000 ticks")
    assert said["in_phase"].note.startswith("RMS of the last 5 s, ")
    assert said["in_phase"].note.endswith("of the pulse's height")
    assert said["within"].note == "of the 100.0 % of the last 5 s that could be judged"
    assert said["heart"].note == "of the force felt, last 6 s"
    assert said["rejected"] == ("0 messages", "nothing")


def test_a_share_stands_beside_the_part_that_it_is_of() -> None:
    told = Told(LiveState())
    whole = Availability(60.0, 0.16, 0.01, 0.83, 0.0, 0.0, 0.0, 0.0, played=0.17, judged=0.16)
    compensation = {"predicted": 0.012, "trusted": None}
    told.status("stale", availability=asdict(whole), compensation=compensation)
    said = figures(told.live, picture(told.live, SECOND_NS))
    assert said["availability"] == ("16.0 %", "felt 16.0 %, starting 1.0 %, stale 83.0 % of 60.0 s")
    assert said["concealed"] == ("1.2 %", "of the time played (17.0 % of the run)")


def test_what_is_not_current_has_its_age_and_no_heart_rate() -> None:
    told = Told(LiveState())
    told.go(6)
    now, late = 0, 2_300_000_000
    assert (age(told.live, now), age(told.live, late)) == ("", "2.3 s ago")
    assert state(told.live, now) == ("playing", "the pulse is felt")
    assert state(told.live, late) == ("playing", "2.3 s ago")
    shown = picture(told.live, SECOND_NS)
    assert figures(told.live, shown, now)["heart"].value == "75 /min"
    assert figures(told.live, shown, late)["heart"].value == "–"
    told.status("ended", final=True)
    assert age(told.live, late) == ""


def test_how_long_the_pulse_was_held_at_a_limit_is_a_figure() -> None:
    told = Told(LiveState())
    told.status("playing", limited=asdict(Limits(force=Limited(0, 0.0, 0.0))))
    assert figures(told.live, picture(told.live, SECOND_NS))["at-a-limit"].value == "never"
    limits = Limits(force=Limited(312, 4.1, 0.205), slew=Limited(2, 0.2, 0.01))
    told.status("playing", limited=asdict(limits))
    assert figures(told.live, picture(told.live, SECOND_NS))["at-a-limit"] == (
        "4.1 s",
        "force limit 312 times, 4.1 s (20.5 % of the run); slew limit 2 times, 0.2 s"
        " (1.0 % of the run)",
    )


def test_the_last_state_says_that_it_is_the_last() -> None:
    told = Told(LiveState())
    told.go(1)
    assert state(told.live)[0] == "playing"
    told.status("playing", final=True)
    word, note = state(told.live)
    assert word == "ended"
    assert "last state" in note
    told.status("fault", final=True, faults=["feedback lost"])
    assert state(told.live)[0] == "fault"


def test_a_fault_claims_of_the_finger_what_was_measured_and_no_more() -> None:
    told = Told(LiveState())
    told.go(1)
    told.status("fault", faults=["feedback lost"])
    assert state(told.live) == ("fault", "latched until the display is started again")
    told.status("fault", faults=["feedback lost"], finger="pressed with 245 mN")
    assert state(told.live)[1].endswith("; finger: pressed with 245 mN")
    told.status("playing", finger="pressed with 245 mN")
    assert state(told.live)[1] == "the pulse is felt"
