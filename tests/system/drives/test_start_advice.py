"""Messages of a drive that does not start: the failure, its place and advice."""

import errno
import os
import pty
import re
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import can
import pytest
import serial
from typer.testing import CliRunner

from display_node.benches import start_benches
from display_node.cli import app
from display_node.node import DisplayNode
from display_node.scene import DisplayScene
from protocol.config.scene import load_section
from protocol.errors import DriveError, SceneError
from pulse_drives.start_advice import OTHERWISE, START_ADVICE, advised, start_advice
from pulse_drives.tmcl.line import TmclLine
from tests.support.drive_benches import tmcl_scene
from tests.support.log_lines import strays
from tests.support.nodes import ROOT, free_address
from tests.support.sender import SCENES
from tests.support.threaded_bench import ThreadedBench
from tests.system.commissioning.test_bench_command import drive_scene

DRIVES = ROOT / "pulse_drives"


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
    ],
)
def test_a_serial_port_that_cannot_be_opened_gets_advice(
    error: Exception, advice: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serial, "serial_for_url", failing(error))
    text = refused(lambda: TmclLine(tmcl_scene(port="/dev/ttyACM7"), Counter()))
    assert text.startswith("/dev/ttyACM7 cannot be opened: ")
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


@pytest.mark.parametrize(
    ("error", "advice"),
    [
        (OSError(19, "No such device"), "ip link lists the CAN interfaces"),
        (OSError(100, "Network is down"), "sudo ip link set CHANNEL up"),
        (can.CanInterfaceNotImplementedError("Unknown interface type 'x'"), "check `interface`"),
    ],
)
def test_a_can_bus_that_cannot_be_opened_gets_advice(
    error: Exception, advice: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(can, "Bus", failing(error))
    text = refused(lambda: TmclLine(tmcl_scene(interface="socketcan", channel="can7"), Counter()))
    assert text.startswith("CAN bus socketcan can7 cannot be opened: ")
    assert advice in text


def test_every_kind_of_refusal_in_the_code_has_advice() -> None:
    sources = "\n".join(path.read_text(encoding="utf-8") for path in DRIVES.rglob("*.py"))
    kinds = set(re.findall(r'(?:DriveError\(|_miss\()\s*"([a-z ]+)"', sources)) | {"wrong way"}
    assert {"no answer", "garbled", "refused", "unplugged", "not there"} <= kinds
    for kind in kinds:
        assert start_advice(DriveError(kind, "node 1: text")) != OTHERWISE
    assert kinds == {kind for kind, *_ in START_ADVICE}


@pytest.mark.parametrize(
    ("kind", "text", "advice"),
    [
        ("refused", "node 1 has profile 401, not 402", "no drive of profile CiA 402"),
        ("refused", "node 1 refuses 0x1016:1: no such object", "would not stop by itself"),
        ("refused", "the module's heartbeat is 0 ms, not 50", "would not stop by itself"),
        ("refused", "command 5, type 4 is refused: wrong type", "the drive's manual"),
        ("unplugged", "PyTrinamic is missing; pip install 'telepulse[drives]'", ""),
    ],
)
def test_a_drives_own_refusal_gets_advice(kind: str, text: str, advice: str) -> None:
    found = start_advice(DriveError(kind, text))
    assert advice in found
    assert bool(found) == bool(advice)


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


@pytest.fixture
def bench_scene() -> DisplayScene:
    return load_section(SCENES / "tmcl_bench.toml", "display", DisplayScene)


def test_a_node_checks_its_loop_once_before_its_drive_moves(
    bench_scene: DisplayScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged = Mock()
    monkeypatch.setattr("display_node.control.force_loop.refuse_unstable", judged)
    with (
        closing(DisplayNode(bench_scene, [free_address()], "tcp://127.0.0.1:*")) as node,
        ThreadedBench(bench_scene, lambda ms: 0.3) as bench,
    ):
        assert judged.call_count == 1
        bench.call(bench.connect)
        node.use(bench.hardware)
    # Once more by the bench's own display.
    assert judged.call_count == 2


def test_a_drive_without_a_film_needs_an_option(bench_scene: DisplayScene) -> None:
    """The refusal comes before any port of the scene is opened."""
    blind = bench_scene.model_copy(update={"feedback": None})
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
