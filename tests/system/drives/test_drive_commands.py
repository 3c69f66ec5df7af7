"""`telepulse emulate tmcl` and `cia402` as processes; test_emulated_bench.py moves them."""

import signal
import time
from pathlib import Path
from subprocess import STDOUT

import pytest

from tests.support.emulated_bench import bench_scene_text, emulated_tmcl
from tests.support.nodes import process


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(bench_scene_text(tmp_path, "tmcl", watchdog_ms=400), encoding="utf-8")
    return path


@pytest.mark.smoke
def test_a_drive_and_its_film_run_until_they_are_stopped(scene: Path) -> None:
    with emulated_tmcl(scene) as child:
        lines = [scene.parent / name for name in ("drive", "film")]
        assert all(line.is_symlink() for line in lines)
        child.send_signal(signal.SIGTERM)
        assert child.wait(30) == 0
    assert not any(line.is_symlink() for line in lines)


def test_a_drive_that_is_kept_waiting_reports_it(scene: Path) -> None:
    link = str(scene.parent / "drive")
    with process(
        "telepulse", "emulate", "tmcl", str(scene), "--link", link, stderr=STDOUT
    ) as child:
        assert "TMCL module" in child.read_line(30)
        time.sleep(0.3)
        child.send_signal(signal.SIGSTOP)
        time.sleep(0.2)
        child.send_signal(signal.SIGCONT)
        time.sleep(0.3)
        child.terminate()
        output, _ = child.communicate(timeout=30)
    assert "this machine kept the emulated drive waiting for 2" in output
