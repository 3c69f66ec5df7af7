import tomllib
from pathlib import Path

import pytest

from protocol.config.scene import Section, load_section
from protocol.config.scene_file import (
    FOLDERS,
    MAX_CHAIN,
    find_scene,
    load_document,
    merge,
    read_chain,
    scene_names,
    to_toml,
)
from protocol.errors import SceneError
from protocol.provenance import collect
from tests.support.nodes import RADIAL, ROOT


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
    with pytest.raises(SceneError) as caught:
        load_document(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


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


def test_an_installed_package_has_the_scenes_in_their_folder() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    included = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    packaged, checkout = FOLDERS
    assert included["scenes"] == packaged.relative_to(ROOT).as_posix()
    assert checkout == ROOT / "scenes"


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
    with pytest.raises(SceneError) as caught:
        load_section(child, "display", Display)
    assert str(caught.value).startswith(f"{parent}: [display] actuator.gian: unknown key")
    write(parent, '[display.actuator]\nkind = "a"\n[displya]\n')
    assert refusal(child).startswith(f"{parent}: displya: unknown key")
    write(parent, "[display]\n")
    with pytest.raises(SceneError) as caught:
        load_section(child, "display", Display)
    assert str(caught.value) == f"{child}: [display] actuator: missing; it must be given"


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


def test_a_cycle_is_refused_where_it_closes(tmp_path: Path) -> None:
    path = write(tmp_path / "a.toml", 'extends = "b.toml"\n')
    write(tmp_path / "b.toml", 'extends = "../b/c.toml"\n')
    (tmp_path.parent / "b").mkdir(exist_ok=True)
    c = write(tmp_path.parent / "b" / "c.toml", f'extends = "../{tmp_path.name}/a.toml"\n')
    assert "c.toml: extends: " in refusal(path)
    assert refusal(path).endswith("is this scene or extends it in turn")
    c.unlink()


def test_a_chain_that_is_too_long_is_refused(tmp_path: Path) -> None:
    for number in range(MAX_CHAIN):
        write(tmp_path / f"{number}.toml", f'extends = "{number + 1}.toml"\n')
    write(tmp_path / f"{MAX_CHAIN}.toml", "[display]\n")
    where = f"{tmp_path}/{MAX_CHAIN - 1}.toml"
    assert refusal(tmp_path / "0.toml").startswith(f"{where}: extends: more")
    assert load_document(tmp_path / "1.toml") == {"display": {}}


def test_provenance_has_the_chain_and_the_merged_tables() -> None:
    scene = collect(find_scene("cia402_bench")).scene
    assert [Path(path).stem for path in scene["extends"]] == ["tmcl_bench", "bench"]
    assert scene["tables"]["display"]["drive"]["kind"] == "cia402"
    assert scene["tables"]["display"]["tick"] == "2 ms"
    assert "extends" not in collect(find_scene("radial")).scene


@pytest.mark.parametrize("name", scene_names())
def test_a_shipped_scene_is_the_same_after_writing(name: str) -> None:
    tables = load_document(find_scene(name))
    assert tomllib.loads(to_toml(tables)) == tables


def test_every_type_of_toml_is_written() -> None:
    text = """
        a = [1, [true, "x"], {"k k" = 1.5}]
        "odd key" = "quote \\" back\\\\ \\u0000 \\u007f ünïcode"
        when = 2026-01-02T03:04:05Z
        large = 1e300
        [empty]
        [t."x.y".z]
        b = inf
    """
    tables = tomllib.loads(text)
    assert tomllib.loads(to_toml(tables)) == tables
