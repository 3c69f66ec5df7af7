"""Keys set in a copy of a scene file, in which comments and order stay."""

import tomllib
from pathlib import Path

import tomlkit
from tomlkit.exceptions import TOMLKitError

from protocol.config.scene_file import EXTENDS, load_toml, merge, scene_names
from protocol.errors import SceneError

Changes = dict[str, dict[str, float | str]]
"""Keys and values by table of [display], such as {"film": {"latency": "4 ms"}}."""


def set_keys(path: Path, changes: Changes) -> str:
    """Return the text of a scene with keys set; new ones are at the end of their table.

    Raises SceneError where tomlkit does not set them.
    """
    text = path.read_text(encoding="utf-8")
    try:
        document = tomlkit.parse(text)
        display = document.setdefault("display", tomlkit.table(is_super_table=True))
        for table, keys in changes.items():
            if table in display:
                display[table].update(keys)
            else:
                display[table] = keys
        edited = tomlkit.dumps(document).rstrip("\n") + "\n"
        whole = tomllib.loads(edited) == merge(tomllib.loads(text), {"display": changes})
    except (TOMLKitError, ValueError):
        whole = False
    if not whole:
        raise SceneError(f"{path}: the results of the bench check can only be set by hand")
    return edited


def check_editable(path: Path, target: Path | None) -> None:
    """Check, before the bench check presses the film, that its results can be written.

    They are set in a copy of the scene at `target`. Raises SceneError, also where the scene extends
    a file by a relative path and `target` is in another folder.
    """
    parent = load_toml(path, "scene file").get(EXTENDS)
    moves = target is not None and target.parent.resolve() != path.parent.resolve()
    if moves and parent and parent not in scene_names() and not Path(parent).is_absolute():
        raise SceneError(
            f"{target}: the copy would not find {parent!r}, which {path} extends by a relative"
            f" path; write the copy to the folder {path.parent}"
        )
    set_keys(path, {"actuator": {"latency": "1 ms"}, "film": {"latency": "1 ms"}})
