"""Messages of a drive that does not start: the failure, its place and advice."""

import errno
import os
import pty
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
import serial
from typer.testing import CliRunner

from display_node.benches import start_benches
from display_node.cli import app
from display_node.scene import DisplayScene
from protocol.config.scene import load_section
from protocol.errors import DriveError, SceneError
from protocol.faults import FaultKind
from pulse_drives.start_advice import OTHERWISE, START_ADVICE, advised, start_advice
from pulse_drives.tmcl.line import TmclLine
from tests.support.drive_benches import tmcl_scene
from tests.support.log_lines import strays
from tests.support.nodes import ROOT
from tests.support.sender import SCENES
from tests.system.commissioning.test_bench_command import drive_scene

DRIVES = ROOT / "pulse_drives"
PORT = {"port": "/dev/ttyACM7"}
BUS = {"interface": "socketcan", "channel": "can7"}


def refused(start: Callable[[], object]) -> str:
    """Return the line in which a start is refused."""
    with pytest.raises(DriveError) as error, advised():
        start()
    assert "\n" not in str(error.value)
    return str(error.value)


def failing(error: Exception) -> Callable[..., None]:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    return fail


@pytest.mark.parametrize(
    ("error", "advice"),
    [
        (serial.SerialException(2, "could not open port: No such file"), "/dev/serial/by-id"),
        (serial.SerialException(13, "could not open port: Permission"), "usermod -aG dialout"),
        (serial.SerialException(16, "could not open port: busy"), "another program uses it"),
        (serial.SerialException(5, "could not configure port"), "check the drive's cable"),
        (ValueError("invalid URL, protocol 'x' not known"), "check the drive's cable"),
        (OSError(19, "No such device"), "ip link lists the CAN interfaces"),
        (OSError(100, "Network is down"), "sudo ip link set CHANNEL up"),
        (can.CanInterfaceNotImplementedError("Unknown interface type 'x'"), "check `interface`"),
    ],
)
def test_a_line_that_cannot_be_opened_gets_advice(
    error: Exception, advice: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serial, "serial_for_url", failing(error))
    monkeypatch.setattr(can, "Bus", failing(error))
    on_serial = isinstance(error, serial.SerialException | ValueError)
    line = PORT if on_serial else BUS
    text = refused(lambda: TmclLine(tmcl_scene(**line), Counter()))
    place = "/dev/ttyACM7" if on_serial else "CAN bus socketcan can7"
    assert text.startswith(f"{place} cannot be opened: ")
    assert advice in text


def test_a_serial_port_in_use_gets_advice() -> None:
    master, slave = pty.openpty()
    port = os.ttyname(slave)
    first = TmclLine(tmcl_scene(port=port), Counter())
    try:
        text = refused(lambda: TmclLine(tmcl_scene(port=port), Counter()))
    finally:
        first.close()
        os.close(master)
        os.close(slave)
    assert text.startswith(f"{port} cannot be opened: ")
    assert "another program uses it" in text


def test_every_kind_of_refusal_in_the_code_has_advice() -> None:
    sources = "\n".join(path.read_text(encoding="utf-8") for path in DRIVES.rglob("*.py"))
    names = set(re.findall(r"(?:DriveError\(|_miss\()\s*FaultKind\.([A-Z0-9_]+)", sources))
    assert {"NO_ANSWER", "GARBLED", "REFUSED", "UNPLUGGED", "NOT_THERE"} <= names
    for kind in (FaultKind[name] for name in names):
        assert kind in START_ADVICE
        assert start_advice(DriveError(kind, "node 1: text")) != OTHERWISE


def test_display_node_prints_the_failure_with_its_advice(tmp_path: Path) -> None:
    text = drive_scene(tmp_path).read_text(encoding="utf-8")
    scene = tmp_path / "without_film.toml"
    scene.write_text(text.partition("[display.feedback]")[0], encoding="utf-8")
    ended = CliRunner().invoke(app, [str(scene), "--no-screen", "--without-film"])
    assert ended.exit_code == 2
    (line,) = strays(ended.stderr).splitlines()
    port = re.search(r'port = "([^"]+)"', text.split("[display.drive]")[1])
    assert port is not None
    missing = os.strerror(errno.ENOENT)
    assert line.startswith(f"display-node: {port[1]} cannot be opened: {missing}; ")
    assert "check `port` in [display.drive] and the cable" in line


def test_a_drive_without_a_film_needs_an_option() -> None:
    """The refusal comes before any port of the scene is opened."""
    scene = load_section(SCENES / "tmcl_bench.toml", "display", DisplayScene)
    blind = scene.model_copy(update={"feedback": None})
    with (
        pytest.raises(SceneError, match=r"\[display\.feedback\] is missing.*--without-film"),
        start_benches(blind, SCENES),
    ):
        pass
    with (
        pytest.raises(DriveError, match="cannot be opened"),
        start_benches(blind, SCENES, without_film=True),
    ):
        pass
