from pathlib import Path

import pytest

from protocol.config.scene import Section, load_section
from protocol.config.scene_file import (
    find_scene,
    load_document,
    merge,
    read_chain,
)
from protocol.errors import SceneError
from tests.support.nodes import RADIAL
from tests.support.refusals import refusal_of


class Actuator(Section):
    kind: str
    gain: float = 1.0


class Display(Section):
    actuator: Actuator
    channels: tuple[int, ...] = ()


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def refusal(path: Path) -> str:
    return refusal_of(SceneError, load_document, path)


def test_a_scene_is_found_by_name_and_by_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert find_scene("radial").read_text(encoding="utf-8") == RADIAL.read_text(encoding="utf-8")
    assert find_scene(str(RADIAL)) == RADIAL
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine").touch()
    assert find_scene("mine") == Path("mine")
    with pytest.raises(SceneError, match=r"^radail: no such scene; known by name: .*radial"):
        find_scene("radail")


def test_a_scene_inherits_key_by_key_from_a_file_beside_it(tmp_path: Path) -> None:
    write(
        tmp_path / "parent.toml",
        'title = "old"\n[display]\nchannels = [1, 2]\n[display.actuator]\nkind = "a"\ngain = 2\n',
    )
    child = write(
        tmp_path / "child.toml",
        'extends = "parent.toml"\n[display]\nchannels = [3]\n[display.actuator]\ngain = 5\n',
    )
    assert load_document(child) == {
        "title": "old",
        "display": {"channels": [3], "actuator": {"kind": "a", "gain": 5}},
    }
    assert [path.name for path, _ in read_chain(child)] == ["child.toml", "parent.toml"]


def test_a_table_of_another_kind_replaces_the_inherited_one_whole() -> None:
    old = {"display": {"drive": {"kind": "tmcl", "port": "/dev/x"}, "tick": "1 ms"}}
    new = {"display": {"drive": {"kind": "cia402"}}}
    assert merge(old, new) == {"display": {"drive": {"kind": "cia402"}, "tick": "1 ms"}}
    same = {"display": {"drive": {"kind": "tmcl", "baud": 9600}}}
    assert merge(old, same)["display"]["drive"] == {"kind": "tmcl", "port": "/dev/x", "baud": 9600}


def test_an_error_names_the_file_that_has_the_key(tmp_path: Path) -> None:
    parent = write(tmp_path / "parent.toml", '[display.actuator]\nkind = "a"\ngian = 2\n')
    child = write(tmp_path / "child.toml", 'extends = "parent.toml"\n[display]\nchannels = [1]\n')
    line = refusal_of(SceneError, load_section, child, "display", Display)
    assert line.startswith(f"{parent}: [display] actuator.gian: unknown key")
    write(parent, '[display.actuator]\nkind = "a"\n[displya]\n')
    assert refusal(child).startswith(f"{parent}: displya: unknown key")
    write(parent, "[display]\n")
    text = refusal_of(SceneError, load_section, child, "display", Display)
    assert text == f"{child}: [display] actuator: missing; it must be given"


@pytest.mark.parametrize(
    ("extends", "reason"),
    [
        ('"a.toml"', "extends: {folder}/a.toml is this scene or extends it in turn"),
        ('"gone.toml"', "extends: {folder}/gone.toml: no such scene file"),
        ('"radail"', "extends: radail: no such scene; known by name: "),
        ("3", "extends: must be a scene's name or file, got 3"),
    ],
)
def test_an_invalid_parent_is_refused(extends: str, reason: str, tmp_path: Path) -> None:
    path = write(tmp_path / "a.toml", f"extends = {extends}\n")
    assert refusal(path).startswith(f"{path}: {reason.format(folder=tmp_path)}")
