"""`telepulse study record` with files that people have, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from telepulse.cli.main import app
from tests.support.drawn_beats import draw, noisy
from tests.support.recordings import record

LINK = "delay=40ms,jitter=5ms,loss=1%"


def study(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["study", "record", *map(str, arguments)])


def pulse_csv(folder: Path, seconds: int) -> Path:
    path, force_n = folder / "pulse.csv", noisy(draw().force_n)[: seconds * 1000 : 5]
    table = np.column_stack([np.arange(len(force_n)) / 200, force_n])
    np.savetxt(path, table, "%.5f", ",", header="time [s],force [N]", comments="")
    return path


def test_a_table_in_text_is_predicted_and_played_over_the_link(tmp_path: Path) -> None:
    plot, figures = tmp_path / "pulse.svg", tmp_path / "pulse.json"
    path = pulse_csv(tmp_path, 22)
    result = study(path, "--link", LINK, "--plot", plot, "--json", figures)
    assert result.exit_code == 0, result.output
    assert "22 s" in result.stdout
    for name in ("200 ms", "buffered", 'E = "auto"', "E = 0"):
        assert f"\n  {name} " in result.stdout
    assert plot.read_text(encoding="utf-8").rstrip().endswith("</svg>")
    found = json.loads(figures.read_text(encoding="utf-8"))
    assert found["advice"] in result.stdout
    assert found["height_n"] == pytest.approx(0.31, abs=0.02)
    assert all(each["predicted_n"] < 0.3 * each["held_n"] for each in found["ahead"])
    buffered, auto, at_once = found["playouts"]
    # Buffered is felt as it was; predicted is felt now.
    assert 45 < buffered["delay_ms"] < 70
    assert buffered["aligned_n"] < 0.002
    assert abs(at_once["delay_ms"]) < 1
    assert at_once["in_phase_n"] < 0.1 * buffered["in_phase_n"]
    assert auto["delay_ms"] < buffered["delay_ms"]
    assert buffered["late"] < 0.05 < 0.9 < at_once["late"]
    assert buffered["lost"] == pytest.approx(0.01, abs=0.008)


def test_a_recording_of_a_display_is_studied_and_its_figures_are_printed_alone(
    tmp_path: Path,
) -> None:
    path = tmp_path / "pulse.mcap"
    record(path, 21)
    result = study(path, "--link", "delay=20ms", "--json", "-")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["seconds"] == pytest.approx(21, abs=0.1)
    assert found["link"] == "delay=20ms"
    assert found["playouts"][0]["delay_ms"] == pytest.approx(26, abs=6)


@pytest.mark.parametrize(
    ("seconds", "options", "refusal"),
    [
        (12, ("--link", LINK), "pulse: lasts 12.0 s; a study needs at least 20 s, of which"),
        (22, ("--link", "delay=soon"), "--link 'delay=soon': delay: "),
        (22, ("--link", LINK, "--plot", "pulse.png"), "pulse.png: a plot is written as SVG;"),
        (22, ("--link", LINK, "--channel", "ABP"), "pulse.csv"),
    ],
)
def test_what_cannot_be_studied_is_refused_in_one_line(
    seconds: int,
    options: tuple[str, ...],
    refusal: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    result = study(pulse_csv(tmp_path, seconds), *options)
    assert result.exit_code == 2
    assert result.stdout == ""
    lines = [line for line in result.stderr.splitlines() if line.startswith("telepulse: ")]
    assert len(lines) == 1
    assert refusal in lines[0]
