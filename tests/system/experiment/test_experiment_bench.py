"""Intervals on a drive and a film: in virtual time, and as processes on an emulated drive."""

import re
from functools import partial
from pathlib import Path
from subprocess import PIPE

import numpy as np
import pytest

from protocol.host.child_process import ChildProcess
from telepulse.experiment.interval import IntervalPlayback, PlayedInterval, draw_interval
from telepulse.experiment.log import read_log
from telepulse.experiment.session import Letter, Trial
from tests.support.emulated_bench import bench_scene_text, emulated_tmcl
from tests.support.experiment_sessions import condition, plan, write
from tests.support.nodes import ROOT
from tests.support.sender import MS, display_scene
from tests.support.threaded_bench import ThreadedBench

LINK = "delay=40ms,jitter=5ms,loss=1%"
# On a busy machine the bench stops by faults of its own; the session continues after them.
TRIES = 5
TICK_S = 2e-3
PULSE = """kind = "synthetic"
rate = "1 kHz"
peak_to_peak = "0.3 N"
preload = "0.3 N"
"""


def bench_scene(folder: Path) -> Path:
    """Write the scene of the emulated bench, with longer time-outs and a reproducible pulse."""
    text = bench_scene_text(folder, "tmcl", watchdog_ms=400)
    text = re.sub(r"(?s)(?<=\[sensing.source\]\n).*?(?=\n\[display\])", PULSE, text)
    path = folder / "bench.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_one_interval_after_the_other_is_pressed_by_the_motor(tmp_path: Path) -> None:
    scene = str(bench_scene(tmp_path))
    found = plan(tmp_path, condition("plain", LINK), scene=scene, interval="0.5 s")
    trial = Trial(condition="plain", direct="A", x="B", pulse_seed=3)
    felt: list[PlayedInterval] = []
    letters: tuple[Letter, ...] = ("A", "X", "A")

    with ThreadedBench(display_scene("tmcl_bench"), lambda _: 0.0) as bench:
        bench.call(bench.connect)

        def play(playing: IntervalPlayback) -> None:
            while playing.tick(bench.world.perf_counter_ns()):
                bench.world.sleep(TICK_S)

        def most_n(from_ns: int, until_ns: int) -> float:
            """Return the motor's greatest force from one time to another."""
            return max(m.force_n for m in bench.moments if from_ns <= m.time_ns < until_ns)

        for letter in letters:
            interval = draw_interval(found, 1, 0, trial, letter, 1)
            begin_ns = bench.world.now_ns
            playing = IntervalPlayback(interval, begin_ns, bench.hardware)
            bench.call(partial(play, playing))
            now_ns = bench.world.now_ns
            assert playing.display.safety.faults == []
            felt.append(playing.played())
            opened_ns = begin_ns + interval.foreperiod_ns
            assert most_n(begin_ns, opened_ns) < 0.01
            assert most_n(opened_ns, now_ns) > 0.2
            assert most_n(now_ns - 20 * MS, now_ns) < 0.01
    errors_n = [played.aligned_n or 0 for played in felt]
    # The film's reading is 8 ms old: against the present pulse, the error would be 10 mN.
    assert max(errors_n[0], errors_n[2]) < 3e-3
    # Over the link, everything is predicted.
    assert errors_n[1] > 4e-3


def run_once(session: Path, log: Path) -> str:
    """Run the session; return the error that ended it, or ""."""
    command = ("-m", "telepulse", "experiment", "run", str(session), "--log", str(log), "--yes")
    command += ("--resume",) if log.exists() else ()
    with ChildProcess("session", *command, cwd=ROOT, stdin=PIPE, stdout=PIPE, stderr=PIPE) as child:
        _, error = child.communicate("ax3", timeout=60)
    return error if child.returncode else ""


@pytest.mark.usefixtures("goes_first")
def test_a_session_on_an_emulated_drive(tmp_path: Path) -> None:
    scene, trace = bench_scene(tmp_path), tmp_path / "motor.csv"
    session = write(
        tmp_path / "s.toml", scene=str(scene), kind="rating", trials=1, interval="0.3 s"
    )
    log = tmp_path / "log.jsonl"
    with emulated_tmcl(scene, "--trace", str(trace)):
        for _ in range(TRIES):
            if not (why := run_once(session, log)):
                break
        else:
            pytest.fail(f"not felt to the end in {TRIES} attempts: {why}")
    assert [p.letter for p in read_log(log).answered[0].played] == ["A", "X"]
    force_n = np.genfromtxt(trace, delimiter=",", skip_header=1, usecols=3)
    assert 0.1 < force_n.max() < 2.5
    # From rest to the pulse, for each interval.
    assert np.count_nonzero(np.diff((force_n > 0.1).astype(int)) == 1) >= 2
    assert force_n[-1] == 0
