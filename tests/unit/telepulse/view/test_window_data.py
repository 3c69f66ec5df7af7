import math

import numpy as np
import pytest

from telepulse.view.live import LiveState
from telepulse.view.window_data import POINTS, window_data, window_scores
from tests.unit.telepulse.view.page_states import (
    BEATS_A_SECOND,
    MEAN_N,
    MS,
    ONE_WAY_NS,
    PLAYOUT_NS,
    SECOND_NS,
    SWING_N,
    SimulatedDisplay,
)

WINDOW_NS = 5 * SECOND_NS
# Force at the finger per force at the wrist, for the same strain.
RATIO = 2.0


@pytest.fixture
def display() -> SimulatedDisplay:
    display = SimulatedDisplay(LiveState())
    display.go(6)
    return display


def test_a_delayed_pulse_has_an_error_in_phase_and_none_aligned(display: SimulatedDisplay) -> None:
    scores = window_scores(display.live, WINDOW_NS).scores
    lag_rad = 2 * math.pi * BEATS_A_SECOND * PLAYOUT_NS * 1e-9
    peak_n = 2 * RATIO * SWING_N * math.sin(lag_rad / 2)
    assert scores.in_phase_n is not None
    assert scores.in_phase_n * math.sqrt(2) == pytest.approx(peak_n, rel=0.03)
    assert scores.aligned_n is not None
    assert scores.aligned_n < 1e-4
    assert scores.within_jnd == 1.0
    assert scores.jnd_n == pytest.approx(0.1 * RATIO * 2 * SWING_N, rel=1e-3)


def test_a_films_reading_is_compared_with_the_pulse_of_its_own_time() -> None:
    display = SimulatedDisplay(LiveState())
    display.film_age_ns = 20 * MS
    display.go(6)
    scores = window_scores(display.live, WINDOW_NS).scores
    assert scores.aligned_n is not None
    assert scores.aligned_n < 1e-4
    lag_rad = 2 * math.pi * BEATS_A_SECOND * PLAYOUT_NS * 1e-9
    assert scores.in_phase_n is not None
    assert scores.in_phase_n == pytest.approx(
        math.sqrt(2) * RATIO * SWING_N * math.sin(lag_rad / 2), rel=0.03
    )


def test_a_pulse_that_is_felt_later_than_the_window_is_long_has_an_aligned_error() -> None:
    display = SimulatedDisplay(LiveState())
    display.playout_ns, display.film_age_ns = 8 * SECOND_NS, 20 * MS
    display.go(15)
    scores = window_scores(display.live, WINDOW_NS).scores
    assert scores.aligned_n is not None
    assert scores.aligned_n < 1e-4
    assert scores.judged == 1.0


def test_each_beat_is_marked_at_its_onset_once_the_next_one_has_begun(
    display: SimulatedDisplay,
) -> None:
    columns = window_data(display.live, WINDOW_NS).columns
    onsets, heights = columns["onset"], columns["height"]
    # The pulse is a sine, which is lowest a quarter of a beat before it passes its mean.
    assert np.diff(onsets["t"]) == pytest.approx(1 / BEATS_A_SECOND, abs=2e-3)
    assert len(onsets["t"]) >= 2
    assert -WINDOW_NS * 1e-9 <= onsets["t"][0] < onsets["t"][-1] < -1 / BEATS_A_SECOND
    assert onsets["y"] == pytest.approx(1e3 * (MEAN_N - SWING_N), rel=0.01)
    assert heights["y"] == pytest.approx(2e3 * SWING_N, rel=0.01)
    assert np.isnan(columns["doubtful"]["y"]).all()


def test_each_force_stands_at_its_own_instant(display: SimulatedDisplay) -> None:
    columns = window_data(display.live, WINDOW_NS).columns
    newest_s = {name: columns[name]["t"][-1] for name in ("wrist", "finger")}
    assert newest_s["finger"] == pytest.approx(0.0, abs=5e-3)
    assert newest_s["wrist"] == pytest.approx(-ONE_WAY_NS * 1e-9, abs=6e-3)
    assert columns["wrist"]["t"][0] == pytest.approx(-5.0, abs=0.02)


def test_a_minute_has_as_few_points_as_five_seconds_and_every_peak() -> None:
    display = SimulatedDisplay(LiveState())
    display.go(20)
    long = window_data(display.live, 60 * SECOND_NS).columns
    assert all(len(column["t"]) <= 1.1 * POINTS for column in long.values())
    assert np.nanmax(long["wrist"]["y"]) == pytest.approx(1e3 * (MEAN_N + SWING_N), rel=1e-4)


def test_without_telemetry_the_window_is_empty() -> None:
    shown = window_data(LiveState(), WINDOW_NS)
    assert all(len(column["t"]) == 0 for column in shown.columns.values())
    assert window_scores(LiveState(), WINDOW_NS).scores == (None,) * 5
    assert all(low < high for low, high in shown.limits.values())


def test_a_share_of_the_window_counts_all_of_it(display: SimulatedDisplay) -> None:
    display.linked = False
    display.go(4, "stale")
    scores = window_scores(display.live, WINDOW_NS).scores
    assert scores.within_jnd == 1.0
    assert scores.judged == pytest.approx(0.2, abs=0.02)


def test_a_heart_rate_is_of_the_pulse_felt_now_and_never_of_a_gap(
    display: SimulatedDisplay,
) -> None:
    display.linked = False
    display.go(0.2, "stale")
    assert window_scores(display.live, WINDOW_NS).heart_rate_per_min is None
    display.go(3, "stale")
    display.linked = True
    # Only one beat since the cut: one before it makes no interval with this one.
    display.go(0.9)
    assert window_scores(display.live, WINDOW_NS).heart_rate_per_min is None
    display.go(2)
    assert window_scores(display.live, WINDOW_NS).heart_rate_per_min == pytest.approx(75, rel=0.02)


def test_a_cut_link_is_a_gap_in_the_curve() -> None:
    display = SimulatedDisplay(LiveState())
    display.go(2)
    display.linked = False
    display.go(0.5, "stale")
    display.linked = True
    display.go(2)
    columns = window_data(display.live, WINDOW_NS).columns
    assert np.isnan(columns["wrist"]["y"]).sum() == 1
    in_gap = (columns["aligned"]["t"] > -2.4) & (columns["aligned"]["t"] < -2.1)
    assert in_gap.any()
    assert np.isnan(columns["aligned"]["y"][in_gap]).all()


def test_late_frames_are_put_in_order_and_copies_left_out() -> None:
    display = SimulatedDisplay(LiveState())
    display.at_ns += 10 * MS
    later_ns = display.at_ns
    display.frame()
    display.at_ns -= 5 * MS
    display.frame(arrived_ns=display.at_ns)
    display.frame(arrived_ns=display.at_ns)
    display.at_ns = later_ns
    wrist = display.live.contactors[0].wrist.since(0)
    assert len(wrist.t_ns) == 10
    assert np.all(np.diff(wrist.t_ns) == MS)


@pytest.mark.parametrize(
    "changes",
    [{"session": 8}, {"t_first_ns": 1 << 62}, {"t_first_ns": 0}, {"channels": 2, "force_n": []}],
)
def test_frames_that_the_display_refuses_are_not_drawn(changes: dict[str, object]) -> None:
    display = SimulatedDisplay(LiveState())
    display.frame(**changes)
    assert len(display.live.contactors[0].wrist.since(0).t_ns) == 0
