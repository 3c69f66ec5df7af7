"""Beats of a recorded sweep by their hold-down, and the chapter that shows them."""

import numpy as np
import pytest

from display_node.scoring.depth_curve import fit_depth_curve
from telepulse.columns import SessionColumns
from telepulse.recording.contents import RecordingContents
from telepulse.recording.findings import HELD, RunFindings
from telepulse.recording.forces import find_trend
from telepulse.recording.pressed_beats import judge_beats
from telepulse.recording.report import press_chapters
from tests.support.recorded_sweeps import SweptWrist, session_of

# The mean arterial pressure of the default wrist on its area.
BEST_N = 1.2


@pytest.fixture(scope="module")
def swept() -> RunFindings:
    """Return findings that contain a sweep of the modelled wrist."""
    recorded, contents = session_of(SweptWrist().taken), RecordingContents()
    session = SessionColumns(1, recorded.description)
    for frame in recorded.frames():
        session.add_frame(frame)
    contents.sessions = [session]
    return RunFindings(contents)


def test_the_curve_of_a_recorded_sweep_has_its_maximum_where_the_wrist_has(
    swept: RunFindings,
) -> None:
    curve = fit_depth_curve([each.point for each in judge_beats(swept.steady_beats)])
    assert curve.best_n.value == pytest.approx(BEST_N, rel=0.05)
    assert len(curve.good) > 40
    (chapter,) = press_chapters(swept)
    assert [plot.name for plot in chapter.plots] == ["press", "height"]


def test_a_press_with_too_few_beats_is_described_and_a_stream_without_one_has_no_chapter() -> None:
    findings = RunFindings(RecordingContents())
    assert list(press_chapters(findings)) == []
    findings.trends[HELD] = find_trend(np.zeros(1), np.ones(1))
    (chapter,) = press_chapters(findings)
    assert [plot.name for plot in chapter.plots] == ["press"]
    assert "too few beats" in chapter.paragraphs[0]
