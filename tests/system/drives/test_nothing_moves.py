"""Real commands on an emulated drive, each with one failure: the drive never moves."""

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from display_node.cli import app as display_app
from telepulse.cli.main import app as telepulse_app
from telepulse.processes import free_addresses
from tests.support.emulated_bench import emulated_tmcl
from tests.support.experiment_sessions import write as write_session
from tests.support.nodes import ROOT, run_python
from tests.system.commissioning.test_bench_command import drive_scene

# Longer than any file system permits, so that no such file can be created.
NO_FILE = "x" * 300
SOURCE = """kind = "synthetic"
preset = "paper"
rate = "1 kHz"
heart_rate = "75 /min"
peak_to_peak = "0.3 N"
preload = "0.3 N"
respiration = 0.256
respiration_rate = "15 /min"
"""
CLEAR = "Is the bench clear of fingers? [y/N]"
# Modules that reach a TMCL module; ours too, as another test may have imported it already.
LINE = ("pytrinamic.tmcl", "pulse_drives.tmcl.line")


@dataclass
class Case:
    """A command line, words of its stderr, its input (`answers`) and its exit status.

    missing: modules that cannot be imported.
    """

    arguments: tuple[str, ...]
    words: str
    missing: tuple[str, ...] = ()
    answers: str = ""
    status: int = 2


@dataclass
class RecordedBench:
    """The scene of an emulated drive and film; `windows`: begin and end of each case in ns."""

    folder: Path
    scene: Path
    windows: dict[str, tuple[int, int]] = field(default_factory=dict)

    def scene_with(self, old: str, new: str) -> str:
        """Return the path of a scene of this bench with a text replaced."""
        text = self.scene.read_text(encoding="utf-8")
        assert old in text
        path = self.folder / f"{abs(hash(new))}.toml"
        path.write_text(text.replace(old, new), encoding="utf-8")
        return str(path)

    def moved(self) -> dict[str, float]:
        """Return the tip's range in mm in each case in which it moved, once the drive has ended."""
        trace = self.folder / "motor.csv"
        time_ns, tip_m = np.genfromtxt(trace, delimiter=",", skip_header=1, usecols=(0, 1)).T
        moved = {}
        for name, (begin_ns, end_ns) in self.windows.items():
            inside = tip_m[(time_ns >= begin_ns) & (time_ns <= end_ns)]
            if len(inside) and np.ptp(inside):
                moved[name] = round(float(np.ptp(inside)) * 1e3, 3)
        return moved

    @contextmanager
    def window(self, name: str) -> Iterator[None]:
        """Record begin and end of a case."""
        begin_ns = time.perf_counter_ns()
        yield
        self.windows[name] = begin_ns, time.perf_counter_ns()


@contextmanager
def emulated_bench(folder: Path) -> Iterator[RecordedBench]:
    bench = RecordedBench(folder, drive_scene(folder))
    with emulated_tmcl(bench.scene, "--trace", str(folder / "motor.csv")):
        yield bench


def run_in_process(case: Case, monkeypatch: pytest.MonkeyPatch) -> tuple[int, str]:
    """Run a command without a process of its own, and without the case's missing modules."""
    ours = case.arguments[0] == "display-node"
    app, arguments = (display_app, case.arguments[1:]) if ours else (telepulse_app, case.arguments)
    with monkeypatch.context() as patch:
        for name in case.missing:
            patch.setitem(sys.modules, name, None)
        result = CliRunner().invoke(app, arguments, input=case.answers)
    return result.exit_code, result.stderr + result.stdout * bool(case.answers)


def run_without(folder: Path, library: str, *arguments: str) -> tuple[int, str]:
    """Run the display node as a process in which, with its sidecars, a library cannot be loaded."""
    hidden = folder / "hidden"
    hidden.mkdir()
    (hidden / f"{library}.py").write_text('raise ImportError("it is hidden")\n', encoding="utf-8")
    environment = {"PYTHONPATH": f"{hidden}:{ROOT}", "PATH": "/usr/bin:/bin"}
    result = run_python("-m", "display_node.cli", *arguments, env=environment)
    return result.returncode, result.stderr


def refuse_a_session(folder: Path) -> "subprocess.CompletedProcess[str]":
    """Run a session as a process, and answer that the bench is not clear."""
    words = ("experiment", "run", folder / "session.toml", "--log", folder / "answered.jsonl")
    return run_python("-m", "telepulse", *map(str, words), input="n")


def cases(bench: RecordedBench, taken: str) -> dict[str, Case]:
    """Return the failures by name. taken: an address that another process has bound."""
    folder, scene = bench.folder, str(bench.scene)
    there = folder / "there.mcap"
    there.write_bytes(b"")
    display = ("display-node", scene, "--no-screen", "--seconds", "0.5")
    checks = ("bench", scene, "--only", "display", "--yes", "--seconds", "1")
    session = str(write_session(folder / "session.toml", scene=scene, kind="rating", trials=1))
    unstable = bench.scene_with('fingertip = "1 N/mm"', 'fingertip = "1 N/mm"\nlatency = "12 ms"')
    unstable_session = str(
        write_session(folder / "unstable.toml", scene=unstable, kind="rating", trials=1)
    )
    board = f'port = "{folder}/no-board"\nframing = "binary"\nrate = "1 kHz"\nunit = "N"\n'
    no_source = bench.scene_with(SOURCE, f'kind = "serial"\n{board}')
    port = taken.rpartition(":")[2]
    (folder / "nowhere").symlink_to(folder / "no such folder" / "file")
    no_file = str(folder / "nowhere")
    return {
        "json": Case((*display, "--json", no_file), "cannot be written"),
        "recording is there": Case((*display, "--record", str(there)), "exists already"),
        "recording": Case((*display, "--record", str(folder / NO_FILE)), "cannot be written"),
        "telemetry": Case((*display, "--telemetry", taken), "cannot bind"),
        "metrics": Case((*display, "--metrics", port), "cannot bind"),
        "address": Case((*display, "--connect", "tcp://no port"), "no port"),
        "key": Case((*display, "--key", str(folder / "no.key")), "no.key"),
        "loop": Case(("display-node", unstable, *display[2:]), "stable"),
        "drive's library": Case(display, "drive", missing=LINE),
        "film": Case(
            ("display-node", bench.scene_with(f"{folder}/film", f"{folder}/no-film"), *display[2:]),
            "no-film",
        ),
        "bench's page": Case((*checks, "--out", no_file), "cannot be written"),
        "bench's plots": Case(
            (*checks, "--out", str(folder / "page")), "need matplotlib", missing=("matplotlib",)
        ),
        "bench's tables": Case((*checks, "--json", no_file), "cannot be written"),
        "bench's scene": Case((*checks, "--write", no_file), "cannot be written"),
        "bench with fingers": Case(
            ("bench", scene, "--only", "display"), CLEAR, answers="n\n", status=1
        ),
        "demo's source": Case(
            ("demo", no_source, "--no-ui", "--seconds", "1"), "no-board: cannot be opened"
        ),
        "session's log": Case(("experiment", "run", session, "--log", no_file), "exists already"),
        "session's loop": Case(
            ("experiment", "run", unstable_session, "--log", str(folder / "1.jsonl"), "--yes"),
            "stable",
        ),
    }


def test_every_failure_comes_before_the_drive_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    (taken,) = free_addresses(1)
    host, port = taken.removeprefix("tcp://").split(":")
    ended: dict[str, tuple[int, str]] = {}
    with socket.create_server((host, int(port))), emulated_bench(tmp_path) as bench:
        wanted = cases(bench, taken)
        for name, case in wanted.items():
            with bench.window(name):
                code, text = run_in_process(case, monkeypatch)
                # The output of the command's own processes comes after its own.
                ended[name] = code, text + capfd.readouterr().err
        record = ("--record", str(tmp_path / "a.mcap"), "--no-screen", "--seconds", "0.5")
        with bench.window("recorder's library"):
            status, error = run_without(tmp_path, "mcap", str(bench.scene), *record)
        with bench.window("session with fingers"):
            answered = refuse_a_session(tmp_path)
    assert bench.moved() == {}
    for name, (code, text) in ended.items():
        assert (name, code) == (name, wanted[name].status), text
        assert wanted[name].words in text, name
    assert answered.returncode == 1, answered.stderr
    assert CLEAR in answered.stdout
    assert status == 2
    assert "recording needs mcap" in error
    assert not (tmp_path / "a.mcap").exists()
