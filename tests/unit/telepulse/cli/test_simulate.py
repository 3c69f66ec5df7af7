"""What `telepulse simulate` prints besides its summary."""

from pathlib import Path

from typer.testing import CliRunner

from telepulse.cli.main import app
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
