"""The finger's sketch compiled for this machine, into a folder, as changed, and with a mistake."""

import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from protocol.errors import ProcessError
from pulse_drives.stepdir.frames import (
    BoardGreeting,
    Format,
    board_reader,
    decode_report,
    encode_command,
)
from telepulse.emulators import sketch
from telepulse.emulators.sketch import Sketch


def test_several_compile_the_same_library_at_once(tmp_path: Path) -> None:
    with ThreadPoolExecutor(2) as pool:
        libraries = list(pool.map(lambda _: sketch.compiled(into=tmp_path), range(2)))
    assert libraries[0] == libraries[1]
    assert list(tmp_path.iterdir()) == [libraries[0]]


def test_another_sketch_is_another_library(tmp_path: Path) -> None:
    firmware = tmp_path / "firmware"
    shutil.copytree(sketch.FIRMWARE, firmware)
    ino = firmware / "telepulse_display" / "telepulse_display.ino"
    before, found, after = ino.read_text("utf-8").partition("FIRMWARE = 1 * 256 + ")
    assert found
    ino.write_text(f"{before}FIRMWARE = 7 * 256 + {after}", encoding="utf-8")
    board = Sketch(sketch.compiled(firmware, tmp_path))
    board.power_up()
    frame = encode_command(Format.GREET, 1, ())
    board.feed(frame)
    board.run(5)
    reports = map(decode_report, board_reader().feed(board.take()))
    (greeting,) = [each for each in reports if isinstance(each, BoardGreeting)]
    assert greeting.firmware >> 8 == 7


def test_a_sketch_that_does_not_compile_is_a_complaint(tmp_path: Path) -> None:
    firmware = tmp_path / "firmware"
    shutil.copytree(sketch.FIRMWARE, firmware)
    (firmware / "host" / "host.cpp").write_text("no C++", encoding="utf-8")
    with pytest.raises(ProcessError, match=r"failed: .*host\.cpp"):
        sketch.compiled(firmware, tmp_path)
