"""The example of a plug-in is built, installed and used, as a third party's is."""

import math
import os
import re
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from telepulse_example.stage import STAGES, StageDrive, StageScene

from telepulse.testing import ConformanceError, check_drive
from tests.support.nodes import ROOT, assert_accounted, free_address, process, read_json, run_python

EXAMPLE = ROOT / "examples" / "plugin"
pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Install the example's wheel into a folder; return an environment in which it is found."""
    folder = tmp_path_factory.mktemp("installed")
    options = ("--no-deps", "--no-build-isolation", "--no-index", "--target", str(folder))
    done = run_python("-m", "pip", "install", "-q", *options, str(EXAMPLE), timeout=120)
    assert done.returncode == 0, done.stderr
    return {**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(folder)))}


def test_a_scene_of_its_kinds_is_simulated(installed: Mapping[str, str], tmp_path: Path) -> None:
    summary = tmp_path / "summary.json"
    command = ("simulate", str(EXAMPLE / "scene.toml"), "--seconds", "4", "--json", str(summary))
    done = run_python("-m", "telepulse", *command, env=installed)
    assert done.returncode == 0, done.stderr
    figures = read_json(summary)
    assert_accounted(figures["samples"])
    assert figures["faults"] == []
    # The beat of a sine of 2 Hz.
    assert figures["beats"]["rate_per_min"] == pytest.approx(120, rel=0.02)
    listed = run_python("-m", "telepulse", "scenes", "kinds", env=installed)
    found = re.findall(r"^telepulse\.(\w+) +(\w+) +telepulse-example 0\.1\.0$", listed.stdout, re.M)
    assert dict(found) == {
        "sources": "sine",
        "sensors": "sine_board",
        "drives": "stage",
        "actuators": "voice_coil",
        "predictors": "damped",
    }


def test_its_own_tests_pass(installed: Mapping[str, str]) -> None:
    options = ("-q", "-c", os.devnull, "--rootdir", str(EXAMPLE), "-p", "no:cacheprovider")
    done = run_python("-m", "pytest", *options, "tests", cwd=EXAMPLE, env=installed)
    assert done.returncode == 0, done.stdout
    assert "10 passed" in done.stdout


def test_live_nodes_use_its_sensor_drive_and_predictor(
    installed: Mapping[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", installed["PYTHONPATH"])
    bench, address, summary = str(EXAMPLE / "bench.toml"), free_address(), tmp_path / "felt.json"
    options = ("--seconds", "4", "--without-film", "--json", str(summary), "--quiet")
    with process("sensing_node.cli", bench, "--bind", address):
        done = run_python("-m", "display_node.cli", bench, "--connect", address, *options)
    assert done.returncode == 0, done.stderr
    figures = read_json(summary)
    assert figures["samples"]["played"] > 1000
    assert figures["faults"] == []


def ignore_limits(drive: Any, now_ns: int) -> None:
    supervisor, units = drive._supervisor, drive._axis.units
    speed_m_per_s = supervisor._target[0]
    if supervisor.fault is not None or not math.isfinite(speed_m_per_s):
        StageDrive._send(drive, now_ns)
        return
    velocity = units.velocity(speed_m_per_s)
    drive._stage.run(units.speed_m_per_s(velocity))
    supervisor.mark_sent(velocity, now_ns)


def wait(drive: Any, speed_m_per_s: float) -> None:
    StageDrive.command(drive, speed_m_per_s)
    time.sleep(0.003)


def start_a_thread(drive: Any) -> None:
    StageDrive.close(drive)
    threading.Thread(target=time.sleep, args=(1.0,), name="left over", daemon=True).start()


def run_on(drive: Any) -> None:
    StageDrive.close(drive)
    drive._stage.run(1e-3)


DRIVES: dict[str, dict[str, Any]] = {
    "mm, and the soft limit is 1 mm: commands must pass": {"_send": ignore_limits},
    "ms: it must not wait for the drive": {"command": wait},
    "without commands the tip is": {"_step": lambda self: None},
    "close leaves a thread that runs on: left over": {"close": start_a_thread},
    "the tip moves after close": {"close": run_on},
}


@pytest.mark.parametrize("message", DRIVES)
def test_a_drives_defect_is_named(message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    made = type("BrokenDrive", (StageDrive,), DRIVES[message])
    monkeypatch.setattr("pulse_drives.load_object", lambda path: made)
    monkeypatch.setattr("telepulse.testing.conformance.ENDS_WITHIN_S", 0.2)
    keys = {"kind": "stage", "name": message, "homing_speed": "20 mm/s", "watchdog": "300 ms"}
    with pytest.raises(ConformanceError) as caught:
        check_drive(StageScene, keys, lambda: STAGES[message].position_m)
    assert message in str(caught.value)
