import errno
import math
import os
from pathlib import Path

import pytest

from telepulse.recording import mcap_writer
from telepulse.recording.mcap_writer import McapWriter
from telepulse.recording.reader import RecordingReader
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import FRAME, TICK


def test_memory_is_bounded_while_the_disk_is_full_and_what_finds_no_room_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    monkeypatch.setattr(mcap_writer, "MAX_WAITING_BYTES", 3_000)
    write = os.write

    def full(file: int, data: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    writer.add(Entry(FRAME, 0, {}))
    for number in range(100):
        writer.add(Entry(TICK, number, {"now_ns": number}))
        assert writer.flush() == "No space left on device"
    taken = writer.written[TICK]
    assert 0 < taken < 100
    assert writer.dropped == 100 - taken
    monkeypatch.setattr(os, "write", write)
    assert writer.flush() is None
    writer.add(Entry(TICK, 100, {"now_ns": 100}))
    assert writer.close() is None
    reader = RecordingReader(path)
    numbers = [message.fields["now_ns"] for message in reader if message.topic == TICK]
    assert numbers == [*range(taken), 100]
    assert reader.whole


def test_nan_and_infinity_are_left_out_of_json(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    fields = {"data": "", "felt_n": math.nan, "in": {"low": -math.inf, "high": 1.5}}
    writer.add(Entry(FRAME, 0, fields))
    assert writer.close() is None
    (message,) = RecordingReader(path)
    assert message.fields == {"data": "", "in": {"high": 1.5}}
