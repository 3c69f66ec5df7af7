"""Scene files: found by name, read as TOML, merged with the scenes that they extend.

`extends = "radial"` inherits everything from another scene: tables merge key by key, any other
value replaces the inherited one. A table of another `kind` replaces the whole inherited table,
because its keys differ.
"""

import json
import re
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import reduce
from pathlib import Path
from typing import Any

from protocol.config.quantities import shown
from protocol.errors import SceneError, suggest
from protocol.input_files import read_regular, shallow

SECTIONS = ("sensing", "display", "link")
EXTENDS = "extends"
# Longest path that an operating system takes.
LONGEST_NAME = 4096
# Number of files that a scene may consist of, and largest of them: the shipped ones have 2 kB.
MAX_CHAIN, MOST_BYTES = 8, 1 << 18
Tables = dict[str, Any]

_HERE = Path(__file__).parents[1]
# Folders of telepulse's own scenes: in an installed package (pyproject.toml), and in a checkout.
FOLDERS = (_HERE / "scenes", _HERE.parent / "scenes")
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_KEY_SHOWN = 80


def scene_names() -> list[str]:
    """Return the names of the scenes that come with telepulse."""
    return sorted(path.stem for path in _folder().glob("*.toml"))


def find_scene(name: str) -> Path:
    """Return the path of a scene, from a path or the name of a scene that comes with telepulse.

    Raises SceneError when there is no scene of that name.
    """
    if len(name) > LONGEST_NAME:
        raise SceneError(f"{name[:_KEY_SHOWN]}...: {len(name)} characters are no scene's name")
    path = Path(name)
    if path.suffix == ".toml" or path.name != name:
        return path
    if name in scene_names():
        return _folder() / f"{name}.toml"
    with suppress(OSError):
        if path.is_file():
            return path
    raise SceneError(f"{name}: no such scene; known by name: {', '.join(scene_names())}")


def read_chain(path: Path) -> list[tuple[Path, Tables]]:
    """Read a scene file and those that it extends: each file and its tables, the scene first.

    The tables are as written, without `extends`. Raises SceneError when a file cannot be read, has
    an unknown section, extends itself through others, or the chain has more than `MAX_CHAIN` files.
    """
    chain: list[tuple[Path, Tables]] = []
    files = set[Path]()
    following: Path | None = path
    while following is not None:
        tables = load_toml(following, "scene file")
        for key in tables:
            if key not in (*SECTIONS, "title", EXTENDS):
                raise SceneError(
                    f"{following}: {place([key])}: unknown key{suggest(key, SECTIONS)}"
                )
        chain.append((following, tables))
        files.add(following.resolve())
        parent = tables.pop(EXTENDS, None)
        following = None if parent is None else _find_parent(following, parent, files)
    return chain


def load_document(path: Path) -> Tables:
    """Return a scene's tables as written, merged with those of the scenes that it extends.

    Raises SceneError.
    """
    return reduce(merge, (tables for _, tables in reversed(read_chain(path))))


def merge(inherited: Tables, own: Tables) -> Tables:
    """Return merged tables, in which `own` entries replace `inherited` ones."""
    merged = dict(inherited)
    for key, value in own.items():
        old = merged.get(key)
        merged[key] = value
        if isinstance(old, dict) and isinstance(value, dict):
            kind = old.get("kind")
            if value.get("kind", kind) == kind:
                merged[key] = merge(old, value)
    return merged


def load_toml(path: Path, what: str) -> Tables:
    """Read a TOML file; the error of a missing file names `what` it is. Raises SceneError."""
    try:
        document = tomllib.loads(shallow(read_regular(path, MOST_BYTES).decode()))
        too_large = next(_too_large(document), None)
    except FileNotFoundError:
        raise SceneError(f"{path}: no such {what}") from None
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"{path}: cannot be read: {reason}") from None
    except ValueError as error:
        # TOMLDecodeError, and numbers of thousands of digits.
        raise SceneError(f"{path}: not TOML: {error}") from None
    if too_large is not None:
        raise SceneError(f"{path}: {place(too_large)}: an integer of more than 64 bits")
    return document


def place(keys: Iterable[int | str]) -> str:
    """Return the keys of a value as one dotted key; long keys are cut."""
    return ".".join(_key(str(key)[:_KEY_SHOWN]) for key in keys)


def _folder() -> Path:
    return next(folder for folder in FOLDERS if folder.is_dir())


def _find_parent(path: Path, parent: object, files: set[Path]) -> Path:
    """Return the file that `path` extends; `files` are those of the chain so far."""
    if not isinstance(parent, str):
        raise SceneError(f"{path}: {EXTENDS}: must be a scene's name or file, got {shown(parent)}")
    try:
        found = path.parent / find_scene(parent)
        resolved, exists = found.resolve(), found.exists()
    except (SceneError, OSError, ValueError, RuntimeError) as error:
        # A null character, links in a circle.
        reason = getattr(error, "strerror", None) or error
        raise SceneError(f"{path}: {EXTENDS}: {reason}") from None
    if resolved in files:
        raise SceneError(f"{path}: {EXTENDS}: {found} is this scene or extends it in turn")
    if not exists:
        raise SceneError(f"{path}: {EXTENDS}: {found}: no such scene file")
    if len(files) >= MAX_CHAIN:
        raise SceneError(f"{path}: {EXTENDS}: more than {MAX_CHAIN} files extend one another")
    return found


def _too_large(value: Any, *keys: int | str) -> Iterator[list[int | str]]:
    """Yield the keys of integers beyond TOML's 64 bits, which Python may refuse to print."""
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _too_large(inner, *keys, key)
    elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
        yield list(keys)


def _key(key: str) -> str:
    # JSON's escapes are valid in TOML.
    return key if _BARE_KEY.fullmatch(key) else json.dumps(key, ensure_ascii=False)
