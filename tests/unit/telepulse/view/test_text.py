from dataclasses import asdict

from protocol.counters import Availability, Limited, Limits
from telepulse.view.live import LiveState
from telepulse.view.picture import picture
from telepulse.view.text import FIGURES, age, figures, state
from tests.support.page_states import SECOND_NS, SimulatedDisplay


def test_an_unknown_figure_is_a_dash() -> None:
    live = LiveState()
    shown = figures(live, picture(live, SECOND_NS))
    assert shown.keys() == FIGURES.keys()
    assert {figure.value for figure in shown.values()} == {"–"}
    assert state(live) == ("waiting", "no telemetry from a display yet")


def test_figures_have_their_units() -> None:
    display = SimulatedDisplay(LiveState())
    display.go(6)
    # A display of another host, that runs for an hour and a half less.
    shown = figures(display.live, picture(display.live, 5 * SECOND_NS))
    values = {name: figure.value for name, figure in shown.items()}
    assert values["heart"] == "75 /min"
    assert values["within"] == "100.0 %"
    assert values["loss"] == "0.00 %"
    assert values["clock"] == "offset 5000.000 s"
    assert shown["clock"].note.startswith("skew 3.0 ppm")
    assert values["predictor"] == "ensemble"
    assert shown["loop"] == ("0 deadline misses", "1000 ticks")
    assert shown["in_phase"].note.startswith("RMS of the last 5 s, ")
    assert shown["in_phase"].note.endswith("of the pulse's height")
    assert shown["within"].note == "of the 100.0 % of the last 5 s that could be judged"
    assert shown["heart"].note == "of the force felt, last 6 s"
    assert shown["rejected"] == ("0 messages", "nothing")


def test_a_share_stands_beside_the_part_that_it_is_of() -> None:
    display = SimulatedDisplay(LiveState())
    whole = Availability(60.0, 0.16, 0.01, 0.83, 0.0, 0.0, 0.0, 0.0, played=0.17, judged=0.16)
    compensation = {"predicted": 0.012, "trusted": None}
    display.status("stale", availability=asdict(whole), compensation=compensation)
    shown = figures(display.live, picture(display.live, SECOND_NS))
    assert shown["availability"] == (
        "16.0 %",
        "felt 16.0 %, starting 1.0 %, stale 83.0 % of 60.0 s",
    )
    assert shown["concealed"] == ("1.2 %", "of the time played (17.0 % of the run)")


def test_what_is_not_current_has_its_age_and_no_heart_rate() -> None:
    display = SimulatedDisplay(LiveState())
    display.go(6)
    now, late = 0, 2_300_000_000
    assert (age(display.live, now), age(display.live, late)) == ("", "2.3 s ago")
    assert state(display.live, now) == ("playing", "the pulse is felt")
    assert state(display.live, late) == ("playing", "2.3 s ago")
    shown = picture(display.live, SECOND_NS)
    assert figures(display.live, shown, now)["heart"].value == "75 /min"
    assert figures(display.live, shown, late)["heart"].value == "–"
    display.status("ended", final=True)
    assert age(display.live, late) == ""


def test_how_long_the_pulse_was_held_at_a_limit_is_a_figure() -> None:
    display = SimulatedDisplay(LiveState())
    display.status("playing", limited=asdict(Limits(force=Limited(0, 0.0, 0.0))))
    assert figures(display.live, picture(display.live, SECOND_NS))["at-a-limit"].value == "never"
    limits = Limits(force=Limited(312, 4.1, 0.205), slew=Limited(2, 0.2, 0.01))
    display.status("playing", limited=asdict(limits))
    assert figures(display.live, picture(display.live, SECOND_NS))["at-a-limit"] == (
        "4.1 s",
        "force limit 312 times, 4.1 s (20.5 % of the run); slew limit 2 times, 0.2 s"
        " (1.0 % of the run)",
    )


def test_the_last_state_is_marked_as_the_last() -> None:
    display = SimulatedDisplay(LiveState())
    display.go(1)
    assert state(display.live)[0] == "playing"
    display.status("playing", final=True)
    word, note = state(display.live)
    assert word == "ended"
    assert "last state" in note
    display.status("fault", final=True, faults=["feedback lost"])
    assert state(display.live)[0] == "fault"


def test_a_fault_claims_of_the_finger_what_was_measured_and_no_more() -> None:
    display = SimulatedDisplay(LiveState())
    display.go(1)
    display.status("fault", faults=["feedback lost"])
    assert state(display.live) == ("fault", "latched until the display is started again")
    display.status("fault", faults=["feedback lost"], finger="pressed with 245 mN")
    assert state(display.live)[1].endswith("; finger: pressed with 245 mN")
    display.status("playing", finger="pressed with 245 mN")
    assert state(display.live)[1] == "the pulse is felt"
