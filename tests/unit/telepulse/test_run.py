"""Runs as arrays agree with the summaries, simulated and recorded."""

import sys
from base64 import b64decode
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib import pyplot as plt

import telepulse
from protocol.summary.fields import Availability, RmsErrors, Summary
from telepulse.run import TickGrid
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


def test_a_run_states_its_rate_and_finds_its_beats() -> None:
    run = telepulse.simulate("radial", seconds=8, display={"predictor": "linear"})
    assert run.rate_hz == 500
    assert "at 500 Hz" in repr(run)
    beats = run.beats()
    per_min = [60 / beat.interval_s for beat in beats]
    assert np.median(per_min) == pytest.approx(run.summary.beats.rate_per_min, rel=0.02)
    assert telepulse.find_beats(run) == beats
    timed = telepulse.find_beats(run.wrist_n, t_s=run.t_s)
    assert [beat.onset_ns for beat in timed] == [beat.onset_ns for beat in beats]
    later = telepulse.find_beats(run.wrist_n, t_s=run.t_s + 100)
    assert [b.onset_ns for b in later] == pytest.approx([b.onset_ns + 1e11 for b in beats], abs=5e6)
    felt = run.beats("felt_n", run.first.name)
    # The felt pulse goes on for one beat more, when the stream has ended.
    assert felt[-2].onset_ns == pytest.approx(beats[-1].onset_ns, abs=60e6)


def test_ticks_that_a_recording_lacks_are_rows_of_nan(tmp_path: Path) -> None:
    record(tmp_path / "whole.mcap", 12)
    # Single ticks, as a busy computer misses them, and a pause.
    missed = {*range(3, 12_000, 7), *range(6_000, 6_500)}
    record(tmp_path / "run.mcap", 12, missed=missed, marks={8_000: "cuff on"})
    whole, run = (telepulse.read_recording(tmp_path / f"{name}.mcap") for name in ("whole", "run"))
    assert run.rate_hz == 1000
    np.testing.assert_array_equal(run.t_s, whole.t_s)
    here = np.array([tick in missed for tick in range(12_000)])
    for key in ("wrist_n", "felt_n", "delay_s"):
        assert np.isnan(getattr(run, key)[here]).all()
        np.testing.assert_array_equal(getattr(run, key)[~here], getattr(whole, key)[~here])
    assert not run.played[here].any()
    assert [at_s for at_s, _ in run.marks] == pytest.approx([8.0])
    # Before the pause the beats are the same; in it there is none.
    onsets_s, expected_s = ([b.onset_ns * 1e-9 for b in each.beats()] for each in (run, whole))
    assert sum(each < 5 for each in onsets_s) >= 3
    early_s = [each for each in expected_s if each < 5]
    assert onsets_s[: len(early_s)] == pytest.approx(early_s, abs=2e-3)
    assert not any(6.0 < each < 6.5 for each in onsets_s)


def test_of_ticks_with_a_long_pause_the_longest_part_is_read(
    tmp_path: Path, logged: list[str]
) -> None:
    record(tmp_path / "run.mcap", 70, missed=range(2_000, 64_000))
    run = telepulse.read_recording(tmp_path / "run.mcap")
    assert (len(run.t_s), run.rate_hz) == (6_000, 1000)
    assert run.played.all()
    (line,) = logged
    assert "ticks are in 2 parts" in line
    assert "6000 of 8000 ticks" in line


def test_ticks_that_would_take_far_more_rows_are_refused() -> None:
    now_ns = np.cumsum([0, 100_000, *[50_000_000_000] * 20])
    with pytest.raises(telepulse.TelepulseError, match=r"^x\.mcap: has 22 ticks, .* too few"):
        TickGrid(Path("x.mcap"), now_ns)


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


@pytest.fixture(scope="module")
def late() -> telepulse.Run:
    """A run that is felt 60 ms after the wrist."""
    return telepulse.simulate(
        "radial", 10, display={"predictor": "linear", "compensation": "60 ms"}
    )


def test_the_averaged_beat_is_felt_later_by_the_perceived_delay(late: telepulse.Run) -> None:
    axes = late.plot_beat()
    assert (axes.get_xlabel(), axes.get_ylabel()) == (
        "time since the onset at the wrist, s",
        "force, N",
    )
    wrist, felt = axes.get_lines()
    t_s, wrist_n = wrist.get_data()
    shift_s = t_s[np.argmax(felt.get_ydata())] - t_s[np.argmax(wrist_n)]
    assert shift_s == pytest.approx(0.06, abs=5e-3)
    assert np.ptp(wrist_n) == pytest.approx(late.summary.beats.height_n, rel=0.05)
    assert axes.get_title().startswith("radial: mean of ")
    _, given = plt.subplots()
    assert late.plot_beat(given, late.first.name) is given
    plt.close("all")


def test_a_beat_is_averaged_over_missed_ticks_and_none_is_refused(late: telepulse.Run) -> None:
    missed = np.arange(len(late.t_s)) % 50 == 0
    torn = {
        name: replace(each, felt_n=np.where(missed, np.nan, each.felt_n))
        for name, each in late.contactors.items()
    }
    titles = [run.plot_beat().get_title() for run in (replace(late, contactors=torn), late)]
    assert titles[0] == titles[1]
    plt.close("all")
    with pytest.raises(telepulse.TelepulseError, match=r"^radial: no good beat was felt whole"):
        replace(late, played=np.zeros_like(late.played)).plot_beat()


def test_the_perceived_delay_is_drawn_over_time(late: telepulse.Run) -> None:
    axes = late.plot_delay()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time, s", "perceived delay E, ms")
    (line,) = axes.get_lines()
    assert np.nanmedian(line.get_ydata()) == pytest.approx(60, abs=1)
    _, given = plt.subplots()
    assert late.plot_delay(given) is given
    plt.close("all")


def test_a_notebook_shows_the_verdict_and_a_plot(
    late: telepulse.Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = replace(late, name="<b>")._repr_html_()
    assert "Run(&#x27;&lt;b&gt;&#x27;" in shown
    assert "The finger felt the pulse 60" in shown
    data = b64decode(shown.partition("data:image/png;base64,")[2].partition('"')[0])
    # The size of a PNG stands behind its signature and the head of its first part.
    assert int.from_bytes(data[16:20]) > 500
    assert plt.get_fignums() == []
    unknown = replace(late, summary=Summary())._repr_html_()
    assert "The recording holds no summary" in unknown
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    without = late._repr_html_()
    assert "The finger felt the pulse 60" in without
    assert "the plot of a run needs matplotlib" in without
