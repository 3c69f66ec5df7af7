"""Beats of a recorded sweep by their hold-down, and the chapter that shows them."""

import numpy as np
import pytest

from display_node.scoring.depth_curve import fit_depth_curve
from protocol.tactile import ElasticLayer
from protocol.wire.stream import Channel, StreamDescription
from telepulse.recording.findings import RunFindings
from telepulse.recording.press_chapter import press_chapters
from telepulse.recording.pressed_beats import MOST_BEATS, PressedBeats
from tests.support.recorded_sweeps import SweptWrist, session_of

# The mean arterial pressure of the default wrist on its area.
BEST_N = 1.2
PERIOD_NS = 1_000_000


@pytest.fixture(scope="module")
def swept() -> RunFindings:
    """Return findings that contain a sweep of the modelled wrist."""
    session, findings = session_of(SweptWrist().taken), RunFindings()
    for number, frame in enumerate(session.frames()):
        arrived_ns = frame.t_first_ns + 20_000_000
        held_n = findings.depth.take(frame, session.description, 0, arrived_ns)
        assert held_n is not None
        at_s = np.array([number * 1e-3])
        findings.trends["wrist_hold_down_n"].add(at_s, np.array([held_n]))
    findings.finish()
    return findings


def test_the_curve_of_a_recorded_sweep_has_its_maximum_where_the_wrist_has(
    swept: RunFindings,
) -> None:
    curve = fit_depth_curve(swept.depth.points())
    assert curve.best_n.value == pytest.approx(BEST_N, rel=0.05)
    assert len(curve.good) > 40
    assert swept.depth.count == len(swept.depth.points()) <= MOST_BEATS


def test_the_chapter_shows_press_and_height_by_hold_down(swept: RunFindings) -> None:
    (chapter,) = press_chapters(swept)
    assert [plot.name for plot in chapter.plots] == ["press", "height"]
    assert "The pulse is highest" in chapter.paragraphs[0]
    assert "Hold-down at the wrist" in chapter.plots[0].caption
    swept.trends["press_n"].add(np.array([0.0]), np.array([1.0]))
    (chapter,) = press_chapters(swept)
    assert "Press of the finger and hold-down at the wrist" in chapter.plots[0].caption
    del swept.trends["press_n"]


def test_a_press_with_too_few_beats_is_described_and_a_stream_without_one_has_no_chapter() -> None:
    findings = RunFindings()
    assert list(press_chapters(findings)) == []
    findings.trends["wrist_hold_down_n"].add(np.zeros(1), np.ones(1))
    (chapter,) = press_chapters(findings)
    assert [plot.name for plot in chapter.plots] == ["press"]
    assert "too few beats" in chapter.paragraphs[0]


def test_a_stream_without_a_load_cell_has_no_hold_down() -> None:
    beats = PressedBeats()
    plain = StreamDescription("plain", PERIOD_NS, 5, (Channel("a"), Channel("b")), ElasticLayer())
    (frame, *_) = session_of(SweptWrist().taken).frames()
    assert beats.take(frame, plain, 0, 0) is None
