import logging
import os
import re
import stat
import sys
from pathlib import Path
from unittest.mock import Mock

import pytest

from protocol.errors import OptionError, OutputError
from protocol.host.output import check_writable, configure_logging, write_whole
from tests.support.refusals import refusal_of

ours, library = logging.getLogger("sensing_node.node"), logging.getLogger("zeroconf")


def test_any_record_is_one_line_with_date_and_level_and_names_its_exception(
    capsys: pytest.CaptureFixture[str],
) -> None:
    configure_logging()
    ours.warning("anna\n12:00:00.000 ERROR \x1b[31mfault joined, 100 %")
    try:
        raise ValueError("no\nsuch")
    except ValueError:
        library.exception("failed")
    record, named = capsys.readouterr().err.splitlines()
    at = r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3}"
    assert re.fullmatch(rf"{at} WARNING anna\\n12:.*\\x1b\[31mfault.* 100 %", record)
    source = r"\(.*test_output.py:\d+\)"
    assert re.fullmatch(rf"{at} ERROR failed: ValueError: no\\nsuch {source}", named)


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_at_a_terminal_a_record_has_its_time_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    here, there = os.openpty()
    with open(here, encoding="utf-8") as reader, open(there, "w", encoding="utf-8") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        configure_logging()
        ours.warning("loose")
        terminal.flush()
        assert re.fullmatch(r"\d\d:\d\d:\d\d\.\d{3} WARNING loose\n", reader.readline())


def test_an_unknown_level_is_refused() -> None:
    with pytest.raises(OptionError, match="level loud: there are debug, info, warning, error"):
        configure_logging("loud")


def test_a_write_that_fails_half_way_leaves_the_old_file_and_no_draft(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "out.json"
    path.write_text("old", encoding="utf-8")
    full = Mock(side_effect=OSError(28, "No space left on device"))
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


@pytest.mark.parametrize("name", ["", "no/out.json", "nowhere", "x" * 300, "file/out"])
def test_an_impossible_file_is_refused_before_and_after(name: str, tmp_path: Path) -> None:
    (tmp_path / "nowhere").symlink_to(tmp_path / "missing" / "file")
    (tmp_path / "file").write_text("", encoding="utf-8")
    for act in (check_writable, lambda path: write_whole(path, "text")):
        line = refusal_of(OutputError, act, tmp_path / name)
        assert line.startswith(f"{tmp_path / name}: cannot be written: ")
    check_writable(tmp_path / "new")
    check_writable(None)
    assert {path.name for path in tmp_path.iterdir()} == {"nowhere", "file"}
