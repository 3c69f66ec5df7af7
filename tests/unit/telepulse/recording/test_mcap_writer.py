"""Writing a recording, also on a full disk, in the form that readers of MCAP need.

The form is that of https://mcap.dev/spec and of Foxglove's documentation of JSON messages and of
foxglove.Log. Foxglove itself is not run.
"""

import errno
import math
import os
import sys
from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import SeekingReader

from protocol.errors import OutputError
from telepulse.recording import mcap_writer
from telepulse.recording.mcap_reader import RecordingReader
from telepulse.recording.mcap_writer import MAX_RUNS, McapWriter, RetryingFile
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import FRAME, SCHEMAS, TICK
from tests.support.recordings import record
from tests.support.refusals import refusal_of


class Disk:
    """Substitute of the system's calls: it takes `room_bytes`, and may fail to keep them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.room_bytes = 10**9
        self.keeps = True
        self._write, self._fsync = os.write, os.fsync
        monkeypatch.setattr(os, "write", self._take)
        monkeypatch.setattr(os, "fsync", self._sync)

    def _take(self, file: int, data: memoryview) -> int:
        if not self.room_bytes:
            raise OSError(errno.ENOSPC, "No space left on device")
        # A call may take less than it was given.
        count = self._write(file, data[: min(self.room_bytes, 3)])
        self.room_bytes -= count
        return count

    def _sync(self, file: int) -> None:
        if not self.keeps:
            raise OSError(errno.EIO, "Input/output error")
        self._fsync(file)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


@pytest.mark.parametrize("trouble", ["full", "not kept"])
def test_pieces_are_written_whole_and_in_order(trouble: str, path: Path, disk: Disk) -> None:
    file = RetryingFile(path)
    for part in (b"fir", b"st"):
        file.write(part)
    assert (file.tell(), path.read_bytes()) == (5, b"")
    assert file.commit(1) is None
    assert (file.waiting, file.waiting_bytes) == (0, 0)
    disk.room_bytes, disk.keeps = (4, True) if trouble == "full" else (10**9, False)
    for number in range(3):
        file.write(b"piece%d" % number)
        assert file.commit(2) in ("No space left on device", "Input/output error")
        assert path.read_bytes() == b"first"
        assert file.waiting == 2 * (number + 1)
    assert file.tell() == len("firstpiece0piece1piece2")
    disk.room_bytes, disk.keeps = 8, True
    assert file.commit(0) == "No space left on device"
    assert path.read_bytes() == b"firstpiece0"
    disk.room_bytes = 10**9
    assert file.commit(0) is None
    assert path.read_bytes() == b"firstpiece0piece1piece2"
    assert (file.waiting, file.waiting_bytes) == (0, 0)
    file.close()


@pytest.mark.parametrize("name", ["there", "nowhere/a", "."])
def test_an_unusable_path_is_one_line_and_nothing_is_overwritten(name: str, tmp_path: Path) -> None:
    (tmp_path / "there").write_bytes(b"precious")
    assert str(tmp_path / name) in refusal_of(OutputError, RetryingFile, tmp_path / name)
    assert (tmp_path / "there").read_bytes() == b"precious"


def test_memory_is_bounded_while_the_disk_is_full_and_what_finds_no_room_is_counted(
    path: Path, disk: Disk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_writer, "MAX_WAITING_BYTES", 3_000)
    writer = McapWriter(path)
    disk.room_bytes = 0
    writer.add(Entry(FRAME, 0, {}))
    for number in range(100):
        writer.add(Entry(TICK, number, {"now_ns": number}))
        assert writer.flush() == "No space left on device"
    taken = writer.written[TICK]
    assert 0 < taken < 100
    assert writer.dropped == 100 - taken
    disk.room_bytes = 10**9
    assert writer.flush() is None
    writer.add(Entry(TICK, 100, {"now_ns": 100}))
    assert writer.close() is None
    reader = RecordingReader(path)
    numbers = [message.fields["now_ns"] for message in reader if message.topic == TICK]
    assert numbers == [*range(taken), 100]
    assert reader.whole


def test_nan_and_infinity_are_left_out_of_json(path: Path) -> None:
    writer = McapWriter(path)
    fields = {"data": "", "felt_n": math.nan, "in": {"low": -math.inf, "high": 1.5}}
    writer.add(Entry(FRAME, 0, fields))
    assert writer.close() is None
    (message,) = RecordingReader(path)
    assert message.fields == {"data": "", "in": {"high": 1.5}}


def test_a_flood_of_provenance_is_bounded_and_counted(path: Path) -> None:
    writer = McapWriter(path)
    for number in range(MAX_RUNS + 5):
        writer.describe({"version": str(number)})
    writer.close()
    assert writer.dropped == 5
    assert path.stat().st_size < 100_000


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "a.mcap"
    record(path, 2)
    return path


def test_the_files_summary_has_counts_and_times(recording: Path) -> None:
    with recording.open("rb") as file:
        reader = SeekingReader(file)
        summary = reader.get_summary()
        assert summary is not None
        counts: Counter[int] = Counter()
        times_ns = []
        for _, channel, message in reader.iter_messages():
            counts[channel.id] += 1
            times_ns.append(message.log_time)
    # In order of time, by the index.
    assert times_ns == sorted(times_ns)
    found = summary.statistics
    assert found is not None
    assert (found.message_count, found.channel_message_counts) == (len(times_ns), dict(counts))
    assert (found.message_start_time, found.message_end_time) == (times_ns[0], times_ns[-1])
    assert {channel.topic for channel in summary.channels.values()} == set(SCHEMAS)
    assert (found.schema_count, found.channel_count) == (len(SCHEMAS), len(SCHEMAS))
    assert found.chunk_count == len(summary.chunk_indexes) > 1
    for chunk in summary.chunk_indexes:
        assert chunk.message_start_time <= chunk.message_end_time
        assert chunk.message_index_length > 0


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such modes")
def test_only_the_owner_reads_a_new_recording(path: Path) -> None:
    McapWriter(path).close()
    assert path.stat().st_mode & 0o777 == 0o600
