"""`telepulse emulate tmcl` and `cia402` as processes, moved by drivers in others."""

import signal
import textwrap
import time
import uuid
from collections.abc import Callable
from pathlib import Path

import pytest
import serial

from display_node.hardware import build_display_drive
from display_node.scene import DisplayScene
from protocol.config.scene import load_section
from pulse_drives.drive import Drive
from pulse_sensors.binary_frames import FrameDecoder
from tests.support.can_messages import udp_multicast_reason
from tests.support.emulated_bench import emulated_tmcl
from tests.support.log_lines import refused
from tests.support.nodes import process
from tests.support.sample_blocks import forces

LONGEST_S = 30.0
# Microstep of the scene's drive: a lead of 2 mm in 3200.
STEP_M = 2e-3 / 3200
SCENE = """
    [display.controller]
    error = "position"
    feed_forward = true
    kp = 190

    [display.actuator]
    kind = "stepper"

    [display.drive]
    {drive}
    touch = "0.6 mm"
    homing_speed = "20 mm/s"
    watchdog = "400 ms"
"""


def scene_with(folder: Path, drive: str) -> Path:
    path = folder / "scene.toml"
    lines = drive.replace("\n", "\n    ")
    path.write_text(textwrap.dedent(SCENE.format(drive=lines)), encoding="utf-8")
    return path


def drive_of(scene: Path) -> Drive:
    display = load_section(scene, "display", DisplayScene)
    assert display.drive is not None
    return build_display_drive(display.drive, display.actuator, display.layer.layer(), 2.5)


def keep(drive: Drive, rate_hz: float, until: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + LONGEST_S
    while not until():
        assert time.monotonic() < deadline_s, drive.status()
        drive.command(rate_hz * STEP_M)
        time.sleep(0.002)


@pytest.fixture
def tmcl_scene(tmp_path: Path) -> Path:
    port = tmp_path / "drive"
    return scene_with(tmp_path, f'kind = "tmcl"\nport = "{port}"\nreply_timeout = "50 ms"')


@pytest.mark.smoke
def test_a_drive_and_its_film_run_until_they_are_stopped(tmcl_scene: Path, tmp_path: Path) -> None:
    film = tmp_path / "film"
    with emulated_tmcl(tmcl_scene) as child:
        drive = drive_of(tmcl_scene)
        drive.start()
        decoder = FrameDecoder(1_000_000)
        forces_n: list[float] = []
        with serial.Serial(str(film), timeout=0) as port:

            def pressed() -> bool:
                forces_n.extend(forces(decoder.feed(port.read(4096))))
                return bool(forces_n) and forces_n[-1] > 0.02

            keep(drive, 1000.0, pressed)
        drive.close()
        child.send_signal(signal.SIGTERM)
        assert child.wait(LONGEST_S) == 0
    assert not film.is_symlink()
    assert decoder.rejected.total() == 0


def test_a_fault_begins_at_its_time(tmcl_scene: Path) -> None:
    with emulated_tmcl(tmcl_scene, "--fault", "overtemperature", "--fault-after", "1.5"):
        drive = drive_of(tmcl_scene)
        drive.start()
        keep(drive, 400.0, lambda: drive.status().position_m > 50e-6)
        assert drive.status().fault is None
        keep(drive, -1.0, lambda: drive.status().fault is not None)
        assert drive.status().fault == "fault: overtemperature"
        drive.close()


def test_a_cia_402_drive_is_moved_from_another_process(tmp_path: Path) -> None:
    if (reason := udp_multicast_reason()) is not None:
        pytest.skip(f"udp_multicast: {reason}")
    channel = f"239.74.163.{2 + uuid.uuid4().int % 200}"
    keys = f'kind = "cia402"\ninterface = "udp_multicast"\nchannel = "{channel}"'
    scene = scene_with(tmp_path, keys)
    with process("telepulse", "emulate", "cia402", str(scene)) as child:
        assert "CiA 402 node 1 on CAN udp_multicast" in child.read_line(LONGEST_S)
        drive = drive_of(scene)
        drive.start()
        keep(drive, 400.0, lambda: drive.status().position_m > 50e-6)
        child.send_signal(signal.SIGTERM)
        keep(drive, 0.0, lambda: drive.status().fault is not None)
        assert child.wait(LONGEST_S) == 0
        assert str(drive.status().fault).startswith(("unplugged", "no answer"))
        drive.close()


@pytest.mark.parametrize(
    ("command", "words"),
    [("cia402", 'kind = "cia402" is needed'), ("tmcl", "no-such: no such scene")],
)
def test_an_unfit_scene_is_refused_in_one_line(tmcl_scene: Path, command: str, words: str) -> None:
    scene = str(tmcl_scene) if command == "cia402" else "no-such"
    assert words in refused("telepulse", "emulate", command, scene)


def test_a_silent_film_does_not_stop_the_drive(tmcl_scene: Path, tmp_path: Path) -> None:
    trace = tmp_path / "motor.csv"
    options = ("--trace", str(trace), "--fault", "film-silent", "--fault-after", "0")
    with emulated_tmcl(tmcl_scene, *options) as child:
        drive = drive_of(tmcl_scene)
        drive.start()
        keep(drive, 400.0, lambda: drive.status().position_m > 50e-6)
        with serial.Serial(str(tmp_path / "film"), timeout=0.2) as port:
            port.reset_input_buffer()
            assert port.read(64) == b""
        drive.close()
        child.send_signal(signal.SIGTERM)
        assert child.wait(LONGEST_S) == 0
    header, *rows = trace.read_text(encoding="utf-8").splitlines()
    assert header == "time_ns,tip_m,speed_m_per_s,force_n,trouble"
    assert rows[-1].endswith(",film-silent")
    assert max(float(row.split(",")[3]) for row in rows) > 0
