import tomllib
from pathlib import Path

import pytest
import tomlkit

from protocol.config.scene_file import find_scene, load_document, merge, scene_names
from protocol.errors import SceneError
from protocol.host.output import write_whole
from telepulse.commissioning.scene_edit import Changes, check_editable, set_keys

SCENE = """title = "a bench"  # mine

[display.actuator] # the stepper
kind = "stepper"
latency = "1 ms"   # guessed
[display.actuator.other]
latency = "9 ms"

[display.film]

# the end
"""
FILM: Changes = {"film": {"latency": "8 ms"}}


@pytest.mark.parametrize(
    ("table", "keys", "edited"),
    [
        ("actuator", {"latency": "4.2 ms"}, SCENE.replace('"1 ms"', '"4.2 ms"')),
        ("actuator", {"k": 9.5}, SCENE.replace("# guessed\n", "# guessed\nk = 9.5\n\n")),
        ("film", {"latency": "8 ms"}, f'{SCENE}latency = "8 ms"\n'),
        ("safety", {"k": 1}, f"{SCENE}\n[display.safety]\nk = 1\n"),
    ],
    ids=["key in its place", "key at the end of its table", "key of an empty table", "table"],
)
def test_a_key_is_set_and_all_else_stays(
    table: str, keys: dict[str, float | str], edited: str, tmp_path: Path
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE, encoding="utf-8")
    assert set_keys(scene, {table: keys}) == edited


def test_every_shipped_scene_can_be_edited(tmp_path: Path) -> None:
    changes: Changes = {"actuator": {"latency": "4.2 ms", "k": 1.5}}
    for path in map(find_scene, scene_names()):
        written = tmp_path / path.name
        write_whole(written, set_keys(path, changes))
        assert load_document(written) == merge(load_document(path), {"display": changes})


def test_a_scene_that_extends_a_file_beside_it_is_written_beside_it(tmp_path: Path) -> None:
    (tmp_path / "far").mkdir()
    (tmp_path / "parent.toml").write_text(SCENE, encoding="utf-8")
    child = tmp_path / "child.toml"
    child.write_text('extends = "parent.toml"\n', encoding="utf-8")
    with pytest.raises(SceneError, match="by a relative path; write the copy to the folder"):
        check_editable(child, tmp_path / "far" / "found.toml")
    check_editable(child, tmp_path / "found.toml")
    write_whole(tmp_path / "found.toml", set_keys(child, FILM))
    assert load_document(tmp_path / "found.toml")["display"]["film"]["latency"] == "8 ms"


@pytest.mark.parametrize(
    "text",
    [
        'display = { film = { radius = "9 mm" } }\n',
        '[display]\nfilm = { radius = "9 mm" }\n',
        '[display]\nfilm.radius = "9 mm"\n',
        '[display.film]\nlatency = """9\nms"""\n',
        "[display.film]\na = 1\n[sensing]\nb = 1\n[display.safety]\nc = 1\n",
        "[display]\r\nx = 1\r\n",
        '[display]\n[[display.contactor]]\nname = "a"\n[display.contactor.film]\nz = 1\n',
    ],
)
def test_a_table_may_be_written_in_any_way(text: str, tmp_path: Path) -> None:
    source, target = tmp_path / "odd.toml", tmp_path / "found.toml"
    source.write_text(text, encoding="utf-8")
    changes: Changes = {**FILM, "actuator": {"k": 1.5, "latency": "2 ms"}}
    write_whole(target, set_keys(source, changes))
    found = tomllib.loads(target.read_text(encoding="utf-8"))
    assert found == merge(tomllib.loads(text), {"display": changes})


def test_keys_that_are_not_set_are_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, target = tmp_path / "scene.toml", tmp_path / "found.toml"
    source.write_text(SCENE, encoding="utf-8")
    monkeypatch.setattr(tomlkit, "dumps", lambda _: SCENE)
    with pytest.raises(SceneError, match="can only be set by hand"):
        check_editable(source, target)
    with pytest.raises(SceneError, match="can only be set by hand"):
        set_keys(source, FILM)
