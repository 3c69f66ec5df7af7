"""The page of a display with several contactors: what it shows of each, and of all."""

import pytest

from telepulse.view.live import LiveState
from telepulse.view.text import CONTACTOR_COLUMNS, NOTHING, contactor_rows
from telepulse.view.window_data import window_data, window_scores
from tests.unit.telepulse.view.page_states import (
    BEATS_A_SECOND,
    MEAN_N,
    MS,
    RATIO,
    SECOND_NS,
    SWING_N,
    SimulatedDisplay,
)

NAMES = ("cun", "guan", "chi")
WINDOW_NS = 5 * SECOND_NS
PEAK_MN = 1e3 * (MEAN_N + SWING_N)


@pytest.fixture
def display() -> SimulatedDisplay:
    display = SimulatedDisplay(LiveState(), names=NAMES)
    display.go(6)
    return display


@pytest.mark.parametrize("chosen", [0, 2])
def test_the_curves_and_scores_are_those_of_the_chosen_contactor(
    display: SimulatedDisplay, chosen: int
) -> None:
    data = window_data(display.live, WINDOW_NS, chosen)
    scores = window_scores(display.live, WINDOW_NS, chosen)
    peak_mn = (1 + chosen) * PEAK_MN
    assert scores.chosen == chosen
    assert data.columns["wrist"]["y"].max() == pytest.approx(peak_mn, rel=1e-3)
    assert data.columns["finger"]["y"].max() == pytest.approx(RATIO * peak_mn, rel=1e-3)
    assert data.columns["height"]["y"] == pytest.approx(2e3 * SWING_N * (1 + chosen), rel=0.01)
    assert scores.scores == scores.all_scores[chosen]
    # Each is felt as late as the others, so that its error in phase is as large as its pulse.
    assert scores.scores.in_phase_n == pytest.approx(
        (1 + chosen) * (scores.all_scores[0].in_phase_n or 0.0), rel=1e-6
    )
    assert scores.scores.aligned_n is not None
    assert scores.scores.aligned_n < 1e-4
    assert scores.heart_rate_per_min == pytest.approx(60 * BEATS_A_SECOND, rel=0.02)


def test_the_forces_at_all_fingers_are_drawn_whichever_is_chosen(display: SimulatedDisplay) -> None:
    data = window_data(display.live, WINDOW_NS, 1)
    peaks_mn = [float(finger["y"].max()) for finger in data.fingers]
    assert peaks_mn == pytest.approx([RATIO * PEAK_MN * n for n in (1, 2, 3)], rel=1e-3)
    low, high = data.limits["fingers"]
    assert low <= 0.0 < peaks_mn[-1] <= high


def test_a_channel_that_the_stream_does_not_have_is_left_out(display: SimulatedDisplay) -> None:
    chi = display.live.contactors[2]
    count = len(chi.wrist.since(0).t_ns)
    display.names = NAMES[:2]
    display.at_ns += 5 * MS
    display.frame()
    assert (
        len(display.live.contactors[1].wrist.since(0).t_ns) > len(chi.wrist.since(0).t_ns) == count
    )


def test_without_telemetry_no_contactor_has_a_force_now(display: SimulatedDisplay) -> None:
    scores, column = window_scores(display.live, WINDOW_NS), CONTACTOR_COLUMNS.index("force now")
    for silent_ns, known in ((0, True), (2 * SECOND_NS, False)):
        forces = [row[column] for row in contactor_rows(display.live, scores, silent_ns)]
        assert len(forces) == len(NAMES)
        assert all((force != NOTHING) == known for force in forces)
