from dataclasses import asdict

from protocol.limits import Limited, Limits
from telepulse.view.live import Live
from telepulse.view.picture import picture
from telepulse.view.words import FIGURES, figures, state

from .told import SECOND_NS, Told


def test_what_is_not_known_is_a_dash() -> None:
    live = Live()
    said = figures(live, picture(live, SECOND_NS))
    assert said.keys() == FIGURES.keys()
    assert {figure.value for figure in said.values()} == {"–"}
    assert state(live) == ("waiting", "no display has been heard yet")


def test_figures_have_their_units() -> None:
    told = Told(Live())
    told.go(6)
    # A display of another host, that runs for an hour and a half less.
    said = figures(told.live, picture(told.live, 5 * SECOND_NS))
    values = {name: figure.value for name, figure in said.items()}
    assert values["heart"] == "75 /min"
    assert values["within"] == "100.0 %"
    assert values["loss"] == "0.00 %"
    assert values["offset"] == "5000.000 s"
    assert values["skew"] == "+3.0 ppm"
    assert values["predictor"] == "ensemble"
    assert values["misses"] == "0"
    assert said["misses"].note == "of 1000 ticks"
    assert said["in_phase"].note.endswith("of the pulse's height")


def test_how_long_the_pulse_was_held_at_a_limit_is_a_figure() -> None:
    told = Told(Live())
    told.status("playing", limited=asdict(Limits(force=Limited(0, 0.0, 0.0))))
    assert figures(told.live, picture(told.live, SECOND_NS))["limited"].value == "never"
    limits = Limits(force=Limited(312, 4.1, 0.205), slew=Limited(2, 0.2, 0.01))
    told.status("playing", limited=asdict(limits))
    assert figures(told.live, picture(told.live, SECOND_NS))["limited"] == (
        "4.1 s",
        "force limit 312 times, 4.1 s (20.5 % of the run); slew limit 2 times, 0.2 s"
        " (1.0 % of the run)",
    )


def test_the_last_state_says_that_it_is_the_last() -> None:
    told = Told(Live())
    told.go(1)
    assert state(told.live)[0] == "playing"
    told.status("playing", final=True)
    word, note = state(told.live)
    assert word == "ended"
    assert "last state" in note
    told.status("fault", final=True, faults=["feedback lost"])
    assert state(told.live)[0] == "fault"


def test_a_fault_claims_of_the_finger_what_was_measured_and_no_more() -> None:
    told = Told(Live())
    told.go(1)
    told.status("fault", faults=["feedback lost"])
    assert state(told.live) == ("fault", "latched until the display is started again")
    told.status("fault", faults=["feedback lost"], finger="pressed with 245 mN")
    assert state(told.live)[1].endswith("; finger: pressed with 245 mN")
    told.status("playing", finger="pressed with 245 mN")
    assert state(told.live)[1] == "the pulse is felt"
