"""The page of a display with several contactors: what it shows of each, and of all."""

import pytest

from protocol.summary.tables import BeatFigures, Summary
from telepulse.telemetry.decoder import without_none
from telepulse.view.live import MAX_CONTACTORS, LiveState
from telepulse.view.plots import FINGER_COLOURS
from telepulse.view.text import beyond, contactor_rows, figures
from telepulse.view.window_data import window_data, window_scores
from tests.support.page_states import (
    BEATS_A_SECOND,
    MEAN_N,
    MS,
    RATIO,
    SECOND_NS,
    SWING_N,
    SimulatedDisplay,
)
from tests.unit.telepulse.test_document import luminance

NAMES = ("cun", "guan", "chi")
WINDOW_NS = 5 * SECOND_NS
PEAK_MN = 1e3 * (MEAN_N + SWING_N)
DOUBTFUL = BeatFigures(count=7, rate_per_min=75.0, height_n=0.3, quality=0.31, alarm=True)


@pytest.fixture
def display() -> SimulatedDisplay:
    display = SimulatedDisplay(LiveState(), names=NAMES)
    display.go(6)
    return display


@pytest.mark.parametrize("chosen", range(3))
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


def test_an_only_contactor_has_no_table_and_no_curves_of_all_fingers() -> None:
    display = SimulatedDisplay(LiveState())
    display.go(1)
    data = window_data(display.live, WINDOW_NS)
    assert data.fingers == ()
    scores = window_scores(display.live, WINDOW_NS)
    assert contactor_rows(display.live, scores) == []
    assert len(scores.all_scores) == 1


def test_the_table_has_a_row_for_each_contactor(display: SimulatedDisplay) -> None:
    several = Summary(
        contactors={"cun": Summary(), "guan": Summary(beats=DOUBTFUL, finger="pressed with 245 mN")}
    )
    display.status("playing", contactors=without_none(several.to_dict()["contactors"]))
    rows = contactor_rows(display.live, window_scores(display.live, WINDOW_NS))
    assert [row[:2] for row in rows] == [[name, f"of {name}"] for name in NAMES]
    forces_mn = [float(row[2].removesuffix(" mN")) for row in rows]
    assert forces_mn[1:] == pytest.approx([2 * forces_mn[0], 3 * forces_mn[0]], abs=3)
    errors_mn = [float(row[4].removesuffix(" mN")) for row in rows]
    assert errors_mn[2] == pytest.approx(3 * errors_mn[0], rel=1e-3)
    assert rows[1][5:] == ["300 mN", "75 /min", "0.31", "pressed with 245 mN"]
    # What the status does not have is a dash, as is a contactor that it lacks.
    assert rows[0][5:] == rows[2][5:] == ["–"] * 4
    # Figures of a contactor have its name, and those of the display none.
    first, second = (
        figures(display.live, window_scores(display.live, WINDOW_NS, chosen)) for chosen in range(2)
    )
    for id in ("heart", "force", "aligned", "within", "pulse"):
        assert second[id].note.startswith("guan: ")
    assert first["pulse"].value == "–"
    for id in ("loss", "clock", "loop", "predictor", "delay"):
        assert first[id] == second[id]


def test_contactors_beyond_the_pages_room_are_counted() -> None:
    names = tuple(f"finger {n}" for n in range(MAX_CONTACTORS + 2))
    display = SimulatedDisplay(LiveState(), names=names)
    display.go(1)
    data = window_data(display.live, WINDOW_NS, MAX_CONTACTORS - 1)
    rows = contactor_rows(display.live, window_scores(display.live, WINDOW_NS))
    assert [row[0] for row in rows] == list(names[:MAX_CONTACTORS])
    assert len(data.fingers) == len(FINGER_COLOURS) == MAX_CONTACTORS
    assert beyond(display.live).startswith("2 more contactors")
    # A choice that this display does not have is that of the first.
    assert window_scores(display.live, WINDOW_NS, MAX_CONTACTORS).chosen == 0


def test_another_run_may_have_other_contactors(display: SimulatedDisplay) -> None:
    display.event("begin", "another run of the display")
    assert display.live.names == [""]
    display.names = NAMES[:2]
    display.status("waiting")
    assert display.live.names == ["cun", "guan"]
    assert window_scores(display.live, WINDOW_NS, 2).chosen == 0


@pytest.mark.parametrize(("names", "rows"), [(NAMES[:1], 3), (NAMES, 2), (NAMES, 4)])
def test_ticks_and_status_that_disagree_on_the_contactors_show_what_both_have(
    names: tuple[str, ...], rows: int
) -> None:
    display = SimulatedDisplay(LiveState(), names=NAMES)
    display.go(1)
    display.names = names
    display.status("playing")
    before = [len(contactor.ticks) for contactor in display.live.contactors]
    display.names = tuple("abcd"[:rows])
    display.linked = False
    display.go(0.1)
    after = [len(contactor.ticks) for contactor in display.live.contactors]
    grown = [new - old for new, old in zip(after, before, strict=True)]
    assert grown == [100 if n < rows else 0 for n in range(len(names))]
    scores = window_scores(display.live, WINDOW_NS, len(names) - 1)
    assert figures(display.live, scores).keys()


def test_a_channel_that_the_stream_does_not_have_is_left_out(display: SimulatedDisplay) -> None:
    chi = display.live.contactors[2]
    count = len(chi.wrist)
    display.names = NAMES[:2]
    display.at_ns += 5 * MS
    display.frame()
    assert len(display.live.contactors[1].wrist) > len(chi.wrist) == count


@pytest.mark.parametrize("ground", ["#ffffff", "#1a2027"])
def test_every_colour_is_distinct_and_legible_in_light_and_dark(ground: str) -> None:
    assert len(set(FINGER_COLOURS)) == MAX_CONTACTORS
    for colour in FINGER_COLOURS:
        two = sorted((luminance(colour), luminance(ground)))
        # WCAG 2.1, criterion 1.4.11: contrast of graphics.
        assert (two[1] + 0.05) / (two[0] + 0.05) >= 3.0
