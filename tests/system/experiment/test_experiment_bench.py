"""A session on a drive and a film, as processes on an emulated drive."""

import re
from pathlib import Path
from subprocess import PIPE

import numpy as np
import pytest

from protocol.host.child_process import ChildProcess
from telepulse.experiment.log import read_log
from tests.support.emulated_bench import bench_scene_text, emulated_tmcl
from tests.support.experiment_sessions import write
from tests.support.nodes import ROOT

# On a busy machine the bench stops by faults of its own; the session continues after them.
TRIES = 5
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
