"""The sections of a scene, each read by its own schema.

A node reads its section and no other. An error is one line that names the file, the section and
the key.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from protocol.config.quantities import in_unit_of, shown
from protocol.config.scene_file import load_document, place, read_chain
from protocol.errors import SceneError, suggest

_UNIT_SUFFIX = re.compile(
    r"_(ns|hz|bit_per_s|m|n|n_per_s|pa|m_per_s|m_per_s2|n_per_m|v|v_per_n|rad)$"
)


class Section(BaseModel):
    """Base of every table in a scene: frozen, without unknown keys.

    Names of fields have units, keys of the file have none: `lead_m` is written `lead = "2 mm"`.
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
        """Refuse an unknown key before anything else, with an error that names the known keys."""
        known = [field.alias or name for name, field in cls.model_fields.items()]
        for key in table if isinstance(table, dict) else ():
            if key not in known:
                raise PydanticCustomError(
                    "unknown_key", "unknown key {key}", {"key": str(key), "known": known}
                )
        return table


SectionT = TypeVar("SectionT", bound=Section)
# Type of the error of a table that its kind's own model refuses; its context has the `error`.
IN_KIND = "in_kind"


def load_section(
    path: Path, name: str, schema: type[SectionT], options: Mapping[str, str | None] = {}
) -> SectionT:
    """Read and validate section `name` of the scene at `path`, with what it inherits.

    options: values of the command line's options of the same names, which replace the scene's;
    None leaves the scene's. Raises SceneError, which names the option, or the file of the chain
    that has the key.
    """
    chain = read_chain(path)
    document = load_document(path)
    if name not in document:
        raise SceneError(f"{path}: section [{name}] is missing")
    given = {key: value for key, value in options.items() if value is not None}
    table = document[name]
    if given and isinstance(table, dict):
        table = {**table, **given}
    try:
        return schema.model_validate(table)
    except ValidationError as error:
        keys, text = _first_error(error, table)
        if keys and keys[0] in given:
            raise SceneError(f"--{text}") from None
        at = [name, *keys]
        owner = next((file for file, tables in chain if _follow(at, tables)[0] == at), path)
        raise SceneError(f"{owner}: [{name}] {text}") from None


def validate(table: object, schema: type[SectionT], where: str) -> SectionT:
    """Validate one table; `where` opens the error's line. Raises SceneError."""
    try:
        return schema.model_validate(table)
    except ValidationError as error:
        raise SceneError(f"{where} {_first_error(error, table)[1]}") from None


def _first_error(error: ValidationError, table: Any) -> tuple[list[int | str], str]:
    """Return the first of pydantic's errors: its keys, and a line with how many more there are."""
    every = list(_errors(error))
    location, first = every[0]
    context = first.get("ctx", {})
    keys, written = _follow(location, table)
    match first["type"]:
        case "unknown_key":
            keys.append(context["key"])
            text = "unknown key" + suggest(context["key"], context["known"])
        case "missing":
            keys.append(location[-1])
            text = "missing; it must be given"
        case "model_type" | "model_attributes_type":
            text = f"must be a table, got {shown(written)}"
        case "value_error":
            text = str(context["error"])
        case _:
            text = f"{_demand(first, written)}, got {shown(written)}"
    at = f"{place(keys)}: " if keys else ""
    more = len(every) - 1
    return keys, at + text + (f" (and {more} more)" if more else "")


def _errors(error: ValidationError) -> Iterator[tuple[tuple[int | str, ...], ErrorDetails]]:
    """Yield each error with its location, also those of a table's kind."""
    for each in error.errors(include_url=False):
        if each["type"] == IN_KIND:
            for location, inner in _errors(each["ctx"]["error"]):
                yield (*each["loc"], *location), inner
        else:
            yield each["loc"], each


def _follow(location: Sequence[int | str], table: Any) -> tuple[list[int | str], Any]:
    """Return the keys of a pydantic location that exist in the table, and the value there.

    pydantic inserts names of its own, such as the member of a union that it tried.
    """
    keys: list[int | str] = []
    for part in location:
        inside = isinstance(table, dict) and part in table
        if inside or (isinstance(table, list) and isinstance(part, int)):
            keys.append(part)
            table = table[part]
    return keys, table


def _demand(error: ErrorDetails, written: object) -> str:
    """Return pydantic's demand, with limits in the unit that the value has in the file."""
    text = error["msg"].replace("Input should", "must")
    for limit in error.get("ctx", {}).values():
        if isinstance(limit, int | float):
            text = text.replace(str(limit), in_unit_of(limit, written))
    return text
