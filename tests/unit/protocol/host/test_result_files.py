import os
import stat
from pathlib import Path

import pytest

from protocol.errors import OutputError
from protocol.host.output import check_writable, write_whole


def test_a_write_that_fails_half_way_leaves_the_old_file_and_no_draft(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "out.json"
    path.write_text("old", encoding="utf-8")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="No space left"):
        write_whole(path, "new" * 1_000_000)
    assert path.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_keeps_its_permissions_and_its_place(tmp_path: Path) -> None:
    path, link = tmp_path / "out.json", tmp_path / "link.json"
    path.write_text("old", encoding="utf-8")
    path.chmod(0o640)
    link.symlink_to(path)
    check_writable(link)
    write_whole(link, "new")
    assert link.is_symlink()
    assert path.read_text(encoding="utf-8") == "new"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640


def test_a_device_is_written_to_directly() -> None:
    check_writable(Path("/dev/null"))
    write_whole(Path("/dev/null"), "text")
    with pytest.raises(OutputError):
        write_whole(Path("/dev/full"), "text")


@pytest.mark.parametrize("name", ["no such folder/out.json", "nowhere", "x" * 300, "file/out"])
def test_what_cannot_be_written_is_refused_before_and_after(name: str, tmp_path: Path) -> None:
    (tmp_path / "nowhere").symlink_to(tmp_path / "missing" / "file")
    (tmp_path / "file").write_text("", encoding="utf-8")
    for act in (check_writable, lambda path: write_whole(path, "text")):
        with pytest.raises(OutputError, match="cannot be written"):
            act(tmp_path / name)
    assert {path.name for path in tmp_path.iterdir()} == {"nowhere", "file"}
