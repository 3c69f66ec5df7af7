"""Runs as arrays agree with the summaries, simulated and recorded."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot as plt

import telepulse
from protocol.summary.fields import Availability, RmsErrors
from tests.support.recordings import GAIN, record

LINK = "delay=40ms,jitter=10ms,loss=1%"


@pytest.fixture(scope="module")
def run() -> telepulse.Run:
    display = {"predictor": "linear", "tick": "1 ms"}
    return telepulse.simulate("radial", seconds=6, link=LINK, display=display)


def test_the_arrays_give_the_errors_of_the_summary(run: telepulse.Run) -> None:
    errors = run.summary.force_rmse_n
    target_n = run.first.force_ratio * run.wrist_n
    in_phase_n = run.felt_n - target_n
    # The last ticks are later than the last sample.
    assert np.sqrt(np.nanmean(in_phase_n[run.played] ** 2)) == pytest.approx(errors.in_phase)
    then_n = np.interp(run.t_s - run.delay_s, run.t_s, target_n)
    aligned_n = (run.felt_n - then_n)[run.played]
    assert np.sqrt(np.nanmean(aligned_n**2)) == pytest.approx(errors.aligned, rel=0.02)
    assert run.force_rmse_n.in_phase == pytest.approx(errors.in_phase)
    assert run.force_rmse_n.aligned == pytest.approx(errors.aligned, rel=0.02)
    np.testing.assert_allclose(run.strain, run.first.strain_per_newton * run.felt_n)


def test_the_masks_and_delays_are_those_of_the_summary(run: telepulse.Run) -> None:
    summary = run.summary
    assert np.count_nonzero(run.played) / len(run.t_s) == pytest.approx(summary.availability.felt)
    # The display's own figure has the error of its clock over the run.
    assert 1e3 * np.nanmean(run.delay_s) == pytest.approx(summary.playout_delay_ms.mean, abs=2)
    assert not run.predicted[np.isnan(run.delay_s)].any()
    due = telepulse.simulate("radial", seconds=3, display={"compensation": "0 ms"}, link=LINK)
    assert due.predicted[due.played].all()


def test_columns_name_each_contactor_but_the_first() -> None:
    run = telepulse.simulate("three_fingers", seconds=1.5, display={"predictor": "linear"})
    assert list(run.contactors) == ["cun", "guan", "chi"]
    columns = run.columns()
    np.testing.assert_array_equal(columns["chi felt_n"], run.contactors["chi"].felt_n)
    assert {len(column) for column in columns.values()} == {len(run.t_s)}
    frame = run.to_dataframe()
    assert list(frame) == list(columns)
    assert (run.about, run.marks) == ({}, [])


def test_a_recording_has_the_same_shape(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", 2)
    run = telepulse.read_recording(str(tmp_path / "run.mcap"))
    assert len(run.t_s) == 2_000
    assert run.name == "run"
    np.testing.assert_allclose(run.felt_n, run.target_n, atol=1e-3)
    assert (~np.isnan(run.wrist_n))[run.played].mean() > 0.95
    assert np.median(run.delay_s[run.played]) == pytest.approx(0.04, abs=1e-3)


def test_the_errors_of_a_recording_are_of_its_ticks_and_its_summary_of_the_whole_run(
    tmp_path: Path,
) -> None:
    whole_run = {
        "availability": Availability(9.0, 1.0),
        "force_rmse_n": RmsErrors(0.05, 0.06),
    }
    record(tmp_path / "run.mcap", 3, whole_run=whole_run)
    run = telepulse.read_recording(tmp_path / "run.mcap")
    assert run.t_s[-1] == pytest.approx(3, abs=2e-3)
    assert run.summary.availability.seconds == 9
    assert run.summary.force_rmse_n == whole_run["force_rmse_n"]
    # Felt 40 ms later, and a thousandth too strong.
    assert run.force_rmse_n.aligned == pytest.approx((GAIN - 1) * 0.3, rel=0.3)
    assert 0.02 < run.force_rmse_n.in_phase < 0.05
    never = replace(run, played=np.zeros_like(run.played))
    assert never.force_rmse_n == RmsErrors(None, None)


def test_a_recording_has_its_marks_and_what_was_stated(tmp_path: Path) -> None:
    record(tmp_path / "run.mcap", 2, marks={500: "cuff on", 1_500: "$ off"}, about={"side": "left"})
    run = telepulse.read_recording(tmp_path / "run.mcap")
    assert run.about == {"side": "left"}
    assert [text for _, text in run.marks] == ["cuff on", "$ off"]
    assert [at_s for at_s, _ in run.marks] == pytest.approx([0.5, 1.5], abs=1e-9)
    panels = run.plot(begin_s=1.0)
    panels[0].figure.canvas.draw()
    for axes in panels:
        vertical = [line for line in axes.get_lines() if list(line.get_ydata()) == [0, 1]]
        assert [line.get_xdata()[0] for line in vertical] == pytest.approx([1.5])
    assert [text.get_text() for text in panels[0].texts] == ["$ off"]
    plt.close()
