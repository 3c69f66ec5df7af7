"""Boards of a demo: the port of each end by what comes on it, and what is asked if unclear."""

import io
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
import serial
from serial.tools import list_ports
from typer.testing import CliRunner

from protocol.errors import SourceError
from pulse_drives.stepdir.frames import (
    BoardMode,
    BoardState,
    CommandAnswer,
    CommandResult,
    Format,
    StateFlag,
    TripCause,
    encode_report,
)
from pulse_sensors.binary_frames import FrameEncoder
from telepulse.cli import boards
from telepulse.cli.boards import End, find_ports, identify
from telepulse.cli.main import app
from telepulse.emulators import PtyPort

ENDS: list[End] = ["finger", "wrist"]
BAUDS = [500_000, 115_200]
STATE = BoardState(7, 0, 0, 0, 0, BoardMode.DISARMED, TripCause.NONE, StateFlag(0), 0, 0)
FINGER = encode_report(STATE)
ANSWER = encode_report(CommandAnswer(1, Format.ARM, CommandResult.DONE, 0))
WRIST = FrameEncoder("int16", 3).frame([[1, 2, 3]] * 4, 4_000)


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(boards, "IDENTIFIED_WITHIN_S", 0.7)


@contextmanager
def sending(*sent: bytes) -> Iterator[list[str]]:
    """Yield the ports of boards, each of which sends its bytes over and over."""
    with ExitStack() as stack:
        ports = [stack.enter_context(closing(PtyPort(None))) for _ in sent]
        ended = threading.Event()

        def send() -> None:
            while not ended.wait(0.005):
                for port, data in zip(ports, sent, strict=True):
                    port.write(data)

        sender = threading.Thread(target=send)
        sender.start()
        stack.callback(sender.join)
        stack.callback(ended.set)
        yield [str(port.path) for port in ports]


def list_usb(monkeypatch: pytest.MonkeyPatch, vendor: int, *ports: str) -> None:
    """Let pyserial list these ports of a USB vendor, and a UART of the machine itself."""
    listed = [SimpleNamespace(device=port, vid=vendor) for port in ports]
    uart = SimpleNamespace(device="/dev/ttyS0", vid=None)
    monkeypatch.setattr(list_ports, "comports", lambda: [uart, *listed])


@pytest.mark.parametrize(
    ("sent", "end"),
    [
        (FINGER, "finger"),
        (WRIST, "wrist"),
        # Noise, a frame of neither end alone, and silence.
        (FINGER[:9] + b"\x7f" + FINGER[10:], None),
        (ANSWER, None),
        (b"", None),
    ],
)
def test_the_frames_on_a_port_show_which_board_is_there(sent: bytes, end: End | None) -> None:
    with sending(sent) as (port,):
        assert identify(port, BAUDS)[:2] == (port, end)


def test_each_rate_is_tried_and_a_single_frame_is_not_believed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    chance = [WRIST]

    class Line(io.BytesIO):
        baudrate = 0

        def read(self, size: int | None = -1) -> bytes:
            if self.baudrate == 115_200:
                return FINGER
            return chance.pop() if chance else b""

    monkeypatch.setattr(serial, "serial_for_url", lambda *_, **__: Line())
    assert identify("COM3", BAUDS).end == "finger"


def test_each_board_is_found_and_an_end_with_none_or_two_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with sending(b"", FINGER, WRIST, FINGER) as ports:
        list_usb(monkeypatch, 0x1A86, *ports[:3], "/dev/none")
        assert find_ports(ENDS, BAUDS) == {"finger": ports[1], "wrist": ports[2]}
        list_usb(monkeypatch, 0x1A86, *ports[1:], "/dev/none")
        with pytest.raises(SourceError) as raised:
            find_ports(ENDS, BAUDS)
        text = str(raised.value)
        assert text.startswith("no port, or several, for the finger's board: /dev/none (cannot be")
        for port, end in zip(ports[1:], ("finger", "wrist", "finger"), strict=True):
            assert f" {port} (the {end})" in text
        monkeypatch.setattr(terminal := io.StringIO(f"{ports[3]}\n"), "isatty", lambda: True)
        monkeypatch.setattr("sys.stdin", terminal)
        assert find_ports(ENDS, BAUDS) == {"finger": ports[3], "wrist": ports[2]}
    assert "Port of the finger's board: " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ("unplugged.toml", "no board was found at a USB port; "),
        ("radial --emulated", 'its drive is not of kind "stepdir"'),
        ("class_bench --emulated --ports a b", "--ports: not with --emulated"),
    ],
)
def test_one_line_says_why_there_is_no_board(
    arguments: str, line: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    ports = ('[sensing.source]\nport = "none"', '[display.drive]\nport = "none"')
    scene = "\n".join(('title = "Unplugged"', 'extends = "class_bench"', *ports))
    Path("unplugged.toml").write_text(scene, encoding="utf-8")
    # A modem is no board.
    list_usb(monkeypatch, 0x12D1, "/dev/ttyACM0")
    result = CliRunner().invoke(app, ["demo", *arguments.split()])
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1)
    assert line in result.stderr
    assert "--emulated" in result.stderr or "class_bench" in result.stderr


def test_nothing_is_opened_before_the_answer(tmp_path: Path) -> None:
    ports = [str(tmp_path / end) for end in ("wrist", "finger")]
    for answer in ("n\n", ""):
        command = ["demo", "class_bench", "--ports", *ports]
        result = CliRunner().invoke(app, command, input=answer)
        assert result.exit_code == 1
        assert "checking the bench" not in result.stdout
        assert f"The finger's board is on {ports[1]}, the wrist's on {ports[0]}." in result.stderr
