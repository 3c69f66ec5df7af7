"""Keys of a scene file set by editing its text, so that comments and order stay."""

import re
import tomllib
from pathlib import Path

from protocol.config.scene_file import EXTENDS, load_toml, scene_names, to_toml
from protocol.errors import SceneError
from protocol.host.output import write_whole

Changes = dict[str, dict[str, float | str]]
"""Keys and values by table of [display], such as {"film": {"latency": "4 ms"}}."""


def set_keys(text: str, changes: Changes) -> str:
    """Return the text of a scene with keys set.

    An existing key is changed in place; a new key is added at the end of its table, a new table at
    the end of the text. Raises SceneError where a table has no [header] of its own.
    """
    lines = text.splitlines()
    for table, keys in changes.items():
        for key, value in keys.items():
            text_of_value = to_toml({"x": value}).strip().removeprefix("x = ")
            _set(lines, f"display.{table}", key, text_of_value)
    edited = "\n".join(lines) + "\n"
    display = tomllib.loads(edited).get("display", {})
    for table, keys in changes.items():
        if not keys.items() <= display.get(table, {}).items():
            raise SceneError(
                f"[display.{table}] is not written as a table of its own: set it by hand"
            )
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
    tried: Changes = {"actuator": {"latency": "1 ms"}, "film": {"latency": "1 ms"}}
    try:
        set_keys(path.read_text(encoding="utf-8"), tried)
    except (tomllib.TOMLDecodeError, AttributeError):
        raise _not_editable(path) from None


def write_scene(source: Path, target: Path, changes: Changes, note: str = "") -> None:
    """Write a copy of a scene with keys set, and a comment at its end.

    Raises SceneError or OutputError.
    """
    try:
        edited = set_keys(source.read_text(encoding="utf-8"), changes)
    except tomllib.TOMLDecodeError:
        raise _not_editable(source) from None
    write_whole(target, edited + (note and note + "\n"))


def _not_editable(path: Path) -> SceneError:
    return SceneError(
        f"{path}: [display.actuator] and [display.film] must each be a table of its own:"
        " otherwise the results of the bench check can only be set by hand"
    )


def _set(lines: list[str], table: str, key: str, value: str) -> None:
    header = re.compile(rf"\s*\[\s*{re.escape(table)}\s*\]\s*(#.*)?")
    begin = next((at for at, line in enumerate(lines) if header.fullmatch(line)), None)
    if begin is None:
        lines += ["", f"[{table}]", f"{key} = {value}"]
        return
    end = next(
        (at for at in range(begin + 1, len(lines)) if lines[at].lstrip().startswith("[")),
        len(lines),
    )
    assigned = re.compile(rf'(\s*{re.escape(key)}\s*=\s*)("[^"]*"|[^"#\s]+)(\s*(?:#.*)?)')
    for at in range(begin + 1, end):
        match = assigned.fullmatch(lines[at])
        if match is not None:
            lines[at] = match[1] + value + match[3]
            return
    while end > begin + 1 and not lines[end - 1].strip():
        end -= 1
    lines.insert(end, f"{key} = {value}")
