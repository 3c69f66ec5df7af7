import errno
import os
from pathlib import Path

import pytest

from protocol.errors import OutputError
from telepulse.recording.mcap_writer import RetryingFile


class Disk:
    """Stands in for the system's calls: takes so many bytes, and may fail to keep them."""

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


def test_pieces_are_on_the_disk_once_they_are_committed(tmp_path: Path, disk: Disk) -> None:
    journal = RetryingFile(tmp_path / "a")
    journal.write(b"01234")
    journal.write(b"56789")
    assert journal.tell() == 10
    assert (tmp_path / "a").read_bytes() == b""
    assert journal.commit(messages=2) is None
    assert (tmp_path / "a").read_bytes() == b"0123456789"
    assert (journal.waiting, journal.waiting_bytes) == (0, 0)
    journal.close()


@pytest.mark.parametrize("trouble", ["full", "not kept"])
def test_only_whole_pieces_stand_there_and_the_rest_follows_in_order(
    trouble: str, tmp_path: Path, disk: Disk
) -> None:
    path = tmp_path / "a"
    journal = RetryingFile(path)
    journal.write(b"first")
    assert journal.commit(1) is None
    disk.room_bytes, disk.keeps = (4, True) if trouble == "full" else (10**9, False)
    for number in range(3):
        journal.write(b"piece%d" % number)
        assert journal.commit(2) in ("No space left on device", "Input/output error")
        assert path.read_bytes() == b"first"
        assert journal.waiting == 2 * (number + 1)
    assert journal.tell() == len("firstpiece0piece1piece2")
    disk.room_bytes, disk.keeps = 8, True
    assert journal.commit(0) == "No space left on device"
    assert path.read_bytes() == b"firstpiece0"
    disk.room_bytes = 10**9
    assert journal.commit(0) is None
    assert path.read_bytes() == b"firstpiece0piece1piece2"
    assert (journal.waiting, journal.waiting_bytes) == (0, 0)
    journal.close()


@pytest.mark.parametrize("name", ["there", "nowhere/a", "."])
def test_a_file_that_cannot_be_made_is_one_line_and_no_file_is_overwritten(
    name: str, tmp_path: Path
) -> None:
    (tmp_path / "there").write_bytes(b"precious")
    with pytest.raises(OutputError) as caught:
        RetryingFile(tmp_path / name)
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert (tmp_path / "there").read_bytes() == b"precious"
