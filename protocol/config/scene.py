"""The scene file: TOML with a section a node, each read by its own schema.

A node reads its section and no other; what is wrong is said in one line that names the file,
the section and the key.
"""

import difflib
import json
import re
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from protocol.config.quantities import in_unit_of, shown
from protocol.errors import SceneError

SECTIONS = ("sensing", "display", "link")
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
_KEY_SHOWN = 80
_UNIT_SUFFIX = re.compile(
    r"_(ns|hz|bit_per_s|m|n|n_per_s|pa|m_per_s|m_per_s2|n_per_m|v|v_per_n|rad)$"
)


class Section(BaseModel):
    """Base of every table in a scene: frozen, no unknown keys, units in names only inside.

    The field `lead_m` is written `lead = "2 mm"` in the file.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
        alias_generator=lambda name: _UNIT_SUFFIX.sub("", name),
        validate_by_name=False,
    )

    @model_validator(mode="before")
    @classmethod
    def _know_keys(cls, table: object) -> object:
        """Refuse an unknown key before anything else, as the error can name what is known."""
        known = [field.alias or name for name, field in cls.model_fields.items()]
        for key in table if isinstance(table, dict) else ():
            if key not in known:
                raise PydanticCustomError(
                    "unknown_key", "unknown key {key}", {"key": key, "known": known}
                )
        return table


SectionT = TypeVar("SectionT", bound=Section)


def load_document(path: Path) -> dict[str, Any]:
    """Read a scene file into its raw tables. Raises SceneError."""
    document = load_toml(path, "scene file")
    for key in document:
        if key not in (*SECTIONS, "title"):
            raise SceneError(f"{path}: {_place([key])}: unknown key{_suggestion(key, SECTIONS)}")
    return document


def load_toml(path: Path, what: str) -> dict[str, Any]:
    """Read a TOML file; `what` it should be is said where there is none. Raises SceneError."""
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise SceneError(f"{path}: no such {what}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: cannot be read: {error}") from None
    except (ValueError, RecursionError) as error:
        # Beside TOMLDecodeError: a number of thousands of digits, thousands of brackets.
        raise SceneError(f"{path}: not TOML: {error}") from None
    for keys in _too_large(document):
        raise SceneError(f"{path}: {_place(keys)}: an integer of more than 64 bits")
    return document


def _too_large(value: Any, *keys: int | str) -> Iterator[list[int | str]]:
    """Where integers are that TOML does not have; Python reads them, and may not print them."""
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from _too_large(inner, *keys, key)
    elif isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
        yield list(keys)


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
        raise SceneError(f"{where} {_first_line(error, table)}") from None


def _first_line(error: ValidationError, table: Any) -> str:
    """The first of pydantic's errors in one line, with how many more there are."""
    first = error.errors(include_url=False)[0]
    context = first.get("ctx", {})
    keys, written = _find(first, table)
    match first["type"]:
        case "unknown_key":
            keys.append(context["key"])
            text = "unknown key" + _suggestion(context["key"], context["known"])
        case "missing":
            text = "missing; it must be given"
        case "model_type" | "model_attributes_type":
            text = f"must be a table, got {shown(written)}"
        case "union_tag_invalid":
            text = f"unknown kind {shown(context['tag'])}; known: {context['expected_tags']}"
        case "union_tag_not_found":
            text = f"{context['discriminator']} is missing; it must be given"
        case "value_error":
            text = str(context["error"])
        case _:
            text = f"{_demand(first, written)}, got {shown(written)}"
    place = f"{_place(keys)}: " if keys else ""
    more = error.error_count() - 1
    return place + text + (f" (and {more} more)" if more else "")


def _find(error: ErrorDetails, table: Any) -> tuple[list[int | str], Any]:
    """The keys that lead through the table to the error, and what is written there.

    pydantic puts names of its own between them, such as which member of a union it tried.
    """
    keys: list[int | str] = []
    for part in error["loc"]:
        inside = isinstance(table, dict) and part in table
        if inside or (isinstance(table, list) and isinstance(part, int)):
            keys.append(part)
            table = table[part]
    if error["type"] == "missing":
        keys.append(error["loc"][-1])
    return keys, table


def _demand(error: ErrorDetails, written: object) -> str:
    """What pydantic demands; a limit in the unit that the value has in the file."""
    text = error["msg"].replace("Input should", "must")
    for limit in error.get("ctx", {}).values():
        if isinstance(limit, int | float):
            text = text.replace(str(limit), in_unit_of(limit, written))
    return text


def _place(keys: list[int | str]) -> str:
    parts = (str(key)[:_KEY_SHOWN] for key in keys)
    return ".".join(part if _BARE_KEY.fullmatch(part) else json.dumps(part) for part in parts)


def _suggestion(key: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(key, known, n=1)
    return f"; did you mean {close[0]}?" if close else f"; known: {', '.join(known)}"
