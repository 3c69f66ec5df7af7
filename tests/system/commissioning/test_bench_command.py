import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from display_node.plant.scene import StepperScene
from telepulse.cli.main import app
from telepulse.scene import load_scene
from tests.support.emulated_bench import emulated_tmcl
from tests.support.nodes import ROOT

SCENES = ("radial", "wan", "bench", "real_bench", "conditioned", "paper")


def bench(scene: str | Path, *options: str, answers: str = "") -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["bench", str(scene), *options], input=answers)
    return result.exit_code, result.stdout, result.stderr


def changed(folder: Path, *replacements: tuple[str, str], added: str = "") -> Path:
    """Write a copy of scenes/bench.toml in which texts are replaced once, and one is added."""
    text = (ROOT / "scenes" / "bench.toml").read_text(encoding="utf-8")
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new, 1)
    scene = folder / "changed.toml"
    scene.write_text(text + added, encoding="utf-8")
    return scene


def rows(path: Path) -> dict[tuple[str, str], dict[str, str]]:
    (table,) = json.loads(path.read_text(encoding="utf-8"))["chapters"][0]["tables"]
    return {(row["part"], row["check"]): row for row in table["rows"]}


@pytest.mark.parametrize("name", SCENES)
def test_the_shipped_scenes_models_pass_their_bench_check(name: str, tmp_path: Path) -> None:
    path = tmp_path / "bench.json"
    status, _, error = bench(name, "--json", str(path))
    assert (status, error) == (0, "")
    found = rows(path)
    assert {part for part, _ in found} == {"wrist", "film", "actuator", "loop"}
    looks = {key for key, row in found.items() if row["verdict"] != "ok"}
    assert looks <= {("loop", "margins")}


def test_identified_keys_are_written_into_a_scene_that_passes(tmp_path: Path) -> None:
    finger = ('fingertip = "1 N/mm"', 'fingertip = "2 N/mm" # rubber\nlatency = "8 ms"')
    scene, found = changed(tmp_path, finger, ("kp = 390", "kp = 60")), tmp_path / "found.toml"
    files = ("--write", str(found), "--out", str(tmp_path / "page"))
    status, out, _ = bench(scene, "--only", "display", *files)
    assert status == 0
    assert f"scene: {found}" in out
    assert (tmp_path / "page" / "stairs.svg").exists()
    written = found.read_text(encoding="utf-8")
    assert "# rubber" in written
    assert "# Eq 22 from commanded to felt force: m = " in written
    actuator = load_scene(found).display.actuator
    assert isinstance(actuator, StepperScene)
    assert actuator.fingertip_n_per_m == pytest.approx(2000.0, rel=0.01)
    assert actuator.latency_ns == pytest.approx(8e6, abs=2e5)
    assert bench(found, "--only", "display")[0] == 0


def test_a_loop_that_would_be_unstable_fails_and_gains_are_proposed(tmp_path: Path) -> None:
    late = ('fingertip = "1 N/mm"', 'fingertip = "1 N/mm"\nlatency = "12 ms"')
    scene = changed(tmp_path, late)
    status, out, _ = bench(scene, "--only", "display", "--json", str(tmp_path / "bench.json"))
    assert status == 1
    margins = rows(tmp_path / "bench.json")[("loop", "margins")]
    assert margins["verdict"] == "fail"
    assert "stable" in margins["why"]
    assert "gains for it" in out


DRIVE = """
[display.drive]
kind = "tmcl"
port = "{folder}/drive"
period = "10 ms"
reply_timeout = "50 ms"
watchdog = "200 ms"

[display.safety]
feedback_within = "80 ms"

[display.feedback]
kind = "serial"
port = "{folder}/film"
framing = "binary"
rate = "1 kHz"
unit = "N"
"""


def drive_scene(folder: Path) -> Path:
    limits = ('lead = "2 mm"', 'lead = "2 mm"\nstroke = "20 mm"\nmax_speed = "50 mm/s"')
    return changed(folder, limits, added=DRIVE.format(folder=folder))


@pytest.mark.usefixtures("goes_first")
def test_an_emulated_drive_is_checked_over_its_real_bytes(tmp_path: Path) -> None:
    scene, path = drive_scene(tmp_path), tmp_path / "bench.json"
    with emulated_tmcl(scene):
        bench(scene, "--only", "display", "--yes", "--seconds", "1", "--json", str(path))
    found = rows(path)
    assert "640 commands a second" in found[("drive", "line")]["found"]
    assert found[("film", "missing samples")]["found"] == "0.00 %"
    if ("actuator", "finger") in found:
        assert found[("actuator", "finger")]["verdict"] == "ok"
    else:
        # A machine too busy for real time ends the press, and says why.
        assert found[("drive", "ended early")]["why"]
