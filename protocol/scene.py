"""The scene file: TOML with a section a node, each read by its own schema.

A node reads its section and no other; what is wrong is said in one line that names the file,
the section and the key.
"""

import difflib
import re
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from protocol.errors import SceneError

SECTIONS = ("sensing", "display", "link")
_UNIT_SUFFIX = re.compile(r"_(ns|hz|m|n|n_per_s|pa|m_per_s|m_per_s2|n_per_m|n_s_per_m|kg|v|rad)$")


class Section(BaseModel):
    """Base of every table in a scene: frozen, no unknown keys, units in names only inside.

    The field `lead_m` is written `lead = "2 mm"` in the file.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        alias_generator=lambda name: _UNIT_SUFFIX.sub("", name),
        validate_by_name=False,
    )


SectionT = TypeVar("SectionT", bound=Section)


def load_document(path: Path) -> dict[str, Any]:
    """Read a scene file into its raw tables. Raises SceneError."""
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise SceneError(f"{path}: no such scene file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: cannot be read: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise SceneError(f"{path}: not TOML: {error}") from None
    for key in document:
        if key not in (*SECTIONS, "title"):
            raise SceneError(f"{path}: {key}: unknown key{_suggestion(key, SECTIONS)}")
    return document


def load_section(path: Path, name: str, schema: type[SectionT]) -> SectionT:
    """Read and validate section `name` of the scene at `path`. Raises SceneError."""
    document = load_document(path)
    if name not in document:
        raise SceneError(f"{path}: section [{name}] is missing")
    return validate(document[name], schema, where=f"{path}: [{name}]")


def validate(table: object, schema: type[SectionT], where: str) -> SectionT:
    """Validate one table; `where` opens the error's line. Raises SceneError."""
    try:
        return schema.model_validate(table)
    except ValidationError as error:
        raise SceneError(f"{where} {_first_line(error)}") from None


def _first_line(error: ValidationError) -> str:
    """The first of pydantic's errors in one line, with how many more there are."""
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in first["loc"])
    match first["type"]:
        case "extra_forbidden":
            text = "unknown key"
        case "missing":
            text = "missing; it must be given"
        case "union_tag_invalid":
            text = f"unknown kind; known: {first['ctx']['expected_tags']}"
        case "union_tag_not_found":
            text = "needs a kind"
        case "value_error":
            text = str(first["ctx"]["error"])
        case _:
            text = f"{first['msg']}, got {first['input']!r}"
    more = error.error_count() - 1
    return f"{place}: {text}" + (f" (and {more} more)" if more else "")


def _suggestion(key: str, known: tuple[str, ...]) -> str:
    close = difflib.get_close_matches(key, known, n=1)
    return f"; did you mean {close[0]}?" if close else f"; known: {', '.join(known)}"
