"""A recorded sweep that is pressed anew."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from protocol.errors import DepthError, SourceError
from protocol.wire.description import Channel
from sensing_node.scene import serve_set_points
from telepulse.recording.recorded_wrist import RecordedWrist, exported_session
from telepulse.simulation.simulated_run import BATCH
from tests.support.recorded_sweeps import PERIOD_NS, SweptWrist, session_of


@pytest.fixture(scope="module")
def wrist() -> SweptWrist:
    return SweptWrist()


def press(wrist: RecordedWrist, force_n: float, seconds: float) -> NDArray[np.float64]:
    """Press with a force, and return the samples meanwhile."""
    taken = []
    for _ in range(round(seconds * 1e9) // (BATCH * PERIOD_NS)):
        wrist.press(force_n)
        taken.append(wrist.take(BATCH))
    return np.concatenate(taken)


def test_height_and_shape_follow_the_finger(wrist: SweptWrist) -> None:
    recorded = RecordedWrist(session_of(wrist.taken))
    for force_n in (0.4, 0.9, 1.6, 1.05, 1.2):
        press(recorded, force_n, 2.0)
        values = press(recorded, force_n, 2.5)
        assert np.mean(values[:, 1] - values[:, 0]) == pytest.approx(force_n, rel=0.02)
        height_n = float(np.ptp(values[:, 0]))
        assert height_n == pytest.approx(wrist.artery.height_n(force_n), rel=0.15)
        # A step of the finger is followed by a pulse without jumps.
        assert np.abs(np.diff(values[:, 0])).max() < 0.2 * height_n
    assert recorded.state == "pressing"
    assert serve_set_points(recorded, 1) is not None
    high = values[:, 0] > 0.7 * height_n + values[:, 0].min()
    assert np.diff(np.flatnonzero(np.diff(high.astype(int)) > 0)) == pytest.approx(800, abs=80)


def test_without_set_points_it_eases_off_and_the_pulse_fades(wrist: SweptWrist) -> None:
    recorded = RecordedWrist(session_of(wrist.taken))
    press(recorded, 1.2, 1.0)
    for _ in range(800):
        recorded.take(BATCH)
    assert recorded.state in ("off", "leaving")
    assert np.ptp(recorded.take(1000)[:, 0]) < 1e-3


def test_recordings_that_cannot_be_pressed_are_refused_with_the_reason(wrist: SweptWrist) -> None:
    with pytest.raises(DepthError, match="too few beats"):
        RecordedWrist(session_of(wrist.taken[:3000]))
    others = Channel("pulse"), Channel("left")
    with pytest.raises(SourceError, match="has the channels pulse, left; to be pressed it needs"):
        RecordedWrist(session_of(wrist.taken, others))


def test_an_exported_table_is_the_session_that_was_recorded(
    wrist: SweptWrist, tmp_path: Path
) -> None:
    path, values = tmp_path / "samples.csv", np.concatenate(wrist.taken[:200]).astype("<f4")
    numbers = np.arange(len(values))
    table = np.column_stack([np.full(len(values), 7), numbers, numbers * PERIOD_NS, values])
    # A gap, copies of some samples, and a sample of another session.
    rows = np.concatenate([table[:300], table[400:], table[:50], [[8, 0, 0, 0, 0]]])
    names = "session,sample,t_ns,force_0_n,force_1_n"
    np.savetxt(path, rows, "%.9g", ",", header=names, comments="")
    session = exported_session(path)
    frames = list(session.frames())
    kept = np.concatenate([values[:300], values[400:]])
    assert np.array_equal(np.concatenate([frame.values for frame in frames]), kept)
    assert [frame.first_sample for frame in frames[:8]] == [0, 50, 100, 150, 200, 250, 400, 450]
    assert session.description.period_ns == PERIOD_NS
    assert session.description.channels == wrist.channels
    path.write_text("session,sample,t_ns,force_0_n\n1,2,3,0.1\n", encoding="utf-8")
    with pytest.raises(SourceError, match="no column 'force_1_n'; it has session"):
        exported_session(path)
