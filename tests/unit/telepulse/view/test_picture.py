import math

import numpy as np
import pytest

from telepulse.view.live import LiveState
from telepulse.view.picture import POINTS, nice, picture
from tests.support.page_states import (
    BEATS_A_SECOND,
    FINGER,
    MEAN_N,
    MS,
    ONE_WAY_NS,
    PLAYOUT_NS,
    SECOND_NS,
    SWING_N,
    WRIST,
    Told,
)

WINDOW_NS = 5 * SECOND_NS
# Force at the finger per force at the wrist, for the same strain.
RATIO = 2.0


@pytest.fixture
def told() -> Told:
    told = Told(LiveState())
    told.go(6)
    return told


def test_what_lags_is_wrong_in_phase_and_right_aligned(told: Told) -> None:
    scores = picture(told.live, WINDOW_NS).scores
    lag_rad = 2 * math.pi * BEATS_A_SECOND * PLAYOUT_NS * 1e-9
    peak_n = 2 * RATIO * SWING_N * math.sin(lag_rad / 2)
    assert scores.in_phase_n is not None
    assert scores.in_phase_n * math.sqrt(2) == pytest.approx(peak_n, rel=0.03)
    assert scores.aligned_n is not None
    assert scores.aligned_n < 1e-4
    assert scores.within_jnd == 1.0
    assert scores.jnd_n == pytest.approx(0.1 * RATIO * 2 * SWING_N, rel=1e-3)


def test_the_strains_of_two_layers_are_the_same_where_the_forces_are_not(told: Told) -> None:
    columns = picture(told.live, WINDOW_NS).columns
    peak_n = MEAN_N + SWING_N
    assert columns["wrist"]["y"].max() == pytest.approx(1e3 * peak_n, rel=1e-3)
    assert columns["finger"]["y"].max() == pytest.approx(RATIO * 1e3 * peak_n, rel=1e-3)
    strain = -1e6 * WRIST.strain(peak_n)
    assert columns["wrist_strain"]["y"].max() == pytest.approx(strain, rel=1e-3)
    assert columns["finger_strain"]["y"].max() == pytest.approx(strain, rel=1e-3)
    assert told.live.finger_strain_per_newton == pytest.approx(FINGER.strain_per_newton)


def test_each_force_stands_at_its_own_instant(told: Told) -> None:
    columns = picture(told.live, WINDOW_NS).columns
    newest_s = {name: columns[name]["t"][-1] for name in ("wrist", "finger")}
    assert newest_s["finger"] == pytest.approx(0.0, abs=5e-3)
    assert newest_s["wrist"] == pytest.approx(-ONE_WAY_NS * 1e-9, abs=6e-3)
    assert columns["wrist"]["t"][0] == pytest.approx(-5.0, abs=0.02)


def test_delays_and_clocks_are_what_they_were_made(told: Told) -> None:
    shown = picture(told.live, WINDOW_NS)
    assert shown.columns["one_way"]["y"] == pytest.approx(ONE_WAY_NS / MS)
    playout_ms = shown.columns["playout"]["y"]
    assert playout_ms[~np.isnan(playout_ms)] == pytest.approx(PLAYOUT_NS / MS)
    assert shown.columns["offset"]["y"] == pytest.approx(0.0)
    assert shown.columns["offset_high"]["y"] == pytest.approx(0.05)
    assert shown.columns["skew"]["y"] == pytest.approx(3.0)
    assert shown.heart_rate_per_min == pytest.approx(60 * BEATS_A_SECOND, rel=0.02)


def test_a_minute_is_as_light_as_five_seconds_and_no_peak_is_missing() -> None:
    told = Told(LiveState())
    told.go(20)
    long = picture(told.live, 60 * SECOND_NS).columns
    assert all(len(column["t"]) <= 1.1 * POINTS for column in long.values())
    assert np.nanmax(long["wrist"]["y"]) == pytest.approx(1e3 * (MEAN_N + SWING_N), rel=1e-4)


def test_before_anything_came_there_is_an_empty_picture() -> None:
    shown = picture(LiveState(), WINDOW_NS)
    assert all(len(column["t"]) == 0 for column in shown.columns.values())
    assert shown.scores == (None,) * 5
    assert all(low < high for low, high in shown.limits.values())


def test_a_share_of_the_window_counts_all_of_it(told: Told) -> None:
    told.linked = False
    told.go(4, "stale")
    scores = picture(told.live, WINDOW_NS).scores
    assert scores.within_jnd == 1.0
    assert scores.judged == pytest.approx(0.2, abs=0.02)


def test_a_heart_rate_is_of_what_is_felt_now_and_never_of_a_gap(told: Told) -> None:
    assert picture(told.live, WINDOW_NS).heart_rate_per_min == pytest.approx(75, rel=0.02)
    told.linked = False
    told.go(0.2, "stale")
    assert picture(told.live, WINDOW_NS).heart_rate_per_min is None
    told.go(3, "stale")
    told.linked = True
    # One beat since: the one before the cut makes no interval with it.
    told.go(0.9)
    assert picture(told.live, WINDOW_NS).heart_rate_per_min is None
    told.go(2)
    assert picture(told.live, WINDOW_NS).heart_rate_per_min == pytest.approx(75, rel=0.02)


def test_a_cut_link_is_a_gap_in_the_curve() -> None:
    told = Told(LiveState())
    told.go(2)
    told.linked = False
    told.go(0.5, "stale")
    told.linked = True
    told.go(2)
    columns = picture(told.live, WINDOW_NS).columns
    assert np.isnan(columns["wrist"]["y"]).sum() == 1
    in_gap = (columns["aligned"]["t"] > -2.4) & (columns["aligned"]["t"] < -2.1)
    assert in_gap.any()
    assert np.isnan(columns["aligned"]["y"][in_gap]).all()


def test_late_frames_are_put_in_order_and_copies_left_out() -> None:
    told = Told(LiveState())
    told.at_ns += 10 * MS
    later_ns = told.at_ns
    told.frame()
    told.at_ns -= 5 * MS
    told.frame(arrived_ns=told.at_ns)
    told.frame(arrived_ns=told.at_ns)
    told.at_ns = later_ns
    wrist = told.live.wrist.since(0)
    assert len(wrist.t_ns) == 10
    assert np.all(np.diff(wrist.t_ns) == MS)


@pytest.mark.parametrize(
    "changes",
    [{"session": 8}, {"t_first_ns": 1 << 62}, {"t_first_ns": 0}, {"channels": 2, "force_n": []}],
)
def test_frames_that_the_display_refuses_are_not_drawn(changes: dict[str, object]) -> None:
    told = Told(LiveState())
    told.frame(**changes)
    assert len(told.live.wrist) == 0


def test_another_run_of_the_display_begins_afresh(told: Told) -> None:
    told.status("ended", final=True)
    told.event("begin", "another run of the display")
    assert told.live.state == ""
    assert not told.live.final
    assert len(told.live.ticks) == len(told.live.wrist) == 0


def test_limits_are_round_and_change_seldom() -> None:
    assert nice(np.array([0.0, 437.0])) == (0.0, 600.0)
    assert nice(np.array([3.0, math.nan, 437.0, 0.0])) == (0.0, 600.0)
    assert nice(np.array([-31.0, 18.0])) == (-40.0, 20.0)
