import tomllib
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from protocol.config.scene_file import find_scene, load_document, scene_names
from telepulse.cli.main import app


def run(*words: str) -> Result:
    return CliRunner().invoke(app, ["scenes", *words])


def test_every_scene_is_listed_with_its_title() -> None:
    lines = run("list").stdout.splitlines()
    assert [line.split()[0] for line in lines] == scene_names()
    assert "40 ms away" in next(line for line in lines if line.startswith("wan "))


def test_a_copy_is_equal_and_overwrites_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("copy", "wan").exit_code == 0
    assert load_document(tmp_path / "wan.toml") == load_document(find_scene("wan"))
    refused = run("copy", "radial", "wan.toml")
    assert refused.exit_code == 2
    assert refused.stderr == "telepulse: wan.toml: exists already; name another file\n"
    assert "[link]" in (tmp_path / "wan.toml").read_text(encoding="utf-8")


def test_a_scene_is_shown_with_units_and_all_that_it_extends() -> None:
    shown = run("show", "wan").stdout
    assert tomllib.loads(shown) == load_document(find_scene("wan"))
    assert 'lead = "2 mm"' in shown
    assert "extends" not in shown
