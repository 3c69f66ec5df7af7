"""What `telepulse simulate` prints besides its summary."""

import os
import pty
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from telepulse.cli import progress
from telepulse.cli.demo import simulate as simulate_command
from telepulse.cli.main import app
from telepulse.cli.progress import progress_text
from tests.support.signal_files import pulse_and_ecg


def pulse_csv(folder: Path, seconds: float = 4.0, header: str = "time (s),pulse\n") -> Path:
    """Write a table with a column of times; its samples are 0.01 s apart."""
    path = folder / "pulse.csv"
    values = pulse_and_ecg(seconds, 100)["ABP"]
    rows = [f"{n / 100:.2f},{value:.3f}\n" for n, value in enumerate(values)]
    path.write_text(header + "".join(rows), "utf-8")
    return path


def simulate(path: Path, seconds: float) -> tuple[int, str]:
    """Return the exit status of a simulation, and its log with the errors."""
    asked = ["simulate", "--source", str(path), "--seconds", f"{seconds:g}"]
    result = CliRunner().invoke(app, asked, env={"COLUMNS": "200"})
    return result.exit_code, result.stderr


def test_a_recording_that_is_repeated_is_named_with_its_length(tmp_path: Path) -> None:
    status, log = simulate(pulse_csv(tmp_path, 2.0), 5)
    assert status == 0
    assert "INFO the recording lasts 2 s, and the run 5 s: it is played 2.5 times\n" in log
    _, log = simulate(pulse_csv(tmp_path, 2.0), 2)
    assert "it lasts 2 s" in log
    assert "is played" not in log


def test_a_recording_in_a_scene_that_conditions_it_is_named_as_well(tmp_path: Path) -> None:
    scene = tmp_path / "own.toml"
    pulse_csv(tmp_path)
    source = 'kind = "recording"\npath = "pulse.csv"\n'
    chain = '[sensing.conditioning]\nanti_alias = "30 Hz"\nsensitivity = "44 mV/N"\n'
    for repeat, repeated in (("", True), ('repeat = "once"\n', False)):
        scene.write_text(f'extends = "radial"\n[sensing.source]\n{source}{repeat}{chain}', "utf-8")
        result = CliRunner().invoke(app, ["simulate", str(scene), "--seconds", "5"])
        assert ("and the run 5 s: it is played 1.25 times" in result.stderr) == repeated


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("time (s),pulse\n", 'column "time (s)": 1 time is not used, that in row 99 (line 100)'),
        ("", "line 99, 'x,"),
    ],
)
def test_a_time_that_is_no_number_names_its_line(
    tmp_path: Path, header: str, expected: str
) -> None:
    path = pulse_csv(tmp_path, header=header)
    lines = path.read_text("utf-8").splitlines()
    at = 98 + bool(header)
    lines[at] = f"x,{lines[at].split(',')[1]}"
    path.write_text("\n".join(lines) + "\n", "utf-8")
    result = CliRunner().invoke(
        app, ["simulate", "--source", str(path), "--seconds", "3"], env={"COLUMNS": "300"}
    )
    assert expected in result.stdout + result.stderr


def test_a_column_of_times_is_not_offered_as_a_pulse(tmp_path: Path) -> None:
    path = tmp_path / "two.csv"
    values = pulse_and_ecg(4.0, 100)
    table = np.stack([np.arange(400) / 100, values["ABP"], values["RESP"]], axis=1)
    np.savetxt(path, table, delimiter=",", header="time_s,pulse,breath", comments="", fmt="%.4f")
    _, log = simulate(path, 1)
    assert "plays pulse" in log
    assert "the file also has breath (--channel)" in log


@pytest.fixture
def shown_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "FIRST_S", 0.0)
    monkeypatch.setenv("TERM", "xterm")


@pytest.mark.usefixtures("shown_at_once")
def test_a_terminal_shows_the_progress_and_erases_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    reader, terminal = pty.openpty()
    with os.fdopen(terminal, "w") as stderr, monkeypatch.context() as patched:
        patched.setattr(sys, "stderr", stderr)
        with pytest.raises(SystemExit) as ended:
            simulate_command("radial", seconds=1.0)
        stderr.flush()
        output = b""
        # The kernel may deliver what was written in parts.
        while not output.endswith(b"\x1b[2K"):
            output += os.read(reader, 65_536)
    written = output.decode()
    os.close(reader)
    assert ended.value.code == 0
    lines = [line for line in written.split("\r") if "simulated" in line]
    assert " of 1 s, " in lines[0]
    assert "times real time" in lines[0]
    assert "simulated" not in capsys.readouterr().out


@pytest.mark.usefixtures("shown_at_once")
def test_without_a_terminal_no_progress_is_shown() -> None:
    result = CliRunner().invoke(app, ["simulate", "--seconds", "1"])
    assert result.stderr == ""
    assert "simulated" not in result.stdout


def test_the_progress_states_the_speed_so_far() -> None:
    assert progress_text(34.4, 60.0, 4.0) == "simulated 34 of 60 s, 8.6 times real time"
