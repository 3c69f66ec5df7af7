"""The keys of a scene's section, with default and bounds, from the models that read the file."""

import types
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BeforeValidator
from pydantic.fields import FieldInfo

from docs.ext.pages import load
from protocol.config.kinds import OfKind
from protocol.config.quantities import UNITS, parse_ratio
from protocol.config.scene import Section

# Which dimension the suffix of a field's name stands for: `delay_ns` is written `delay = "40 ms"`.
DIMENSIONS = {
    "ns": "time",
    "hz": "frequency",
    "bit_per_s": "bit rate",
    "m": "length",
    "n": "force",
    "n_per_s": "force rate",
    "pa": "pressure",
    "m_per_s": "speed",
    "m_per_s2": "acceleration",
    "n_per_m": "stiffness",
    "v": "voltage",
    "v_per_n": "sensitivity",
    "rad": "angle",
}
_RATIO = "ratio"
_PLAIN = {
    str: "text",
    int: "whole number",
    float: "number",
    bool: "true or false",
    Path: "path",
    dict: "a table",
}


def write(*words: str) -> str:
    """Return heading, table and docstring for each pair of a model and its name in the file.

    The same follows for each table in it; a table shown before is referred to.
    """
    lines: list[str] = []
    shown: dict[type[Section], str] = {}
    for target, name in zip(words[::2], words[1::2], strict=True):
        section = load(target)
        assert isinstance(section, type)
        assert issubclass(section, Section)
        lines += _chapter(section, name, "##", shown)
    return "\n".join(lines)


def _chapter(
    section: type[Section], name: str, level: str, shown: dict[type[Section], str]
) -> Iterator[str]:
    kind = _kind(section)
    header = name if name.startswith("[[") else f"[{name}]"
    title = f"`{header}`" + (f' with `kind = "{kind}"`' if kind else "")
    yield f"{level} {title}\n"
    if section in shown:
        yield f"As {shown[section]}.\n"
        return
    shown[section] = title
    yield "| key | what it is | default | bounds |\n|---|---|---|---|"
    inner = []
    for field_name, field in section.model_fields.items():
        key = field.alias or field_name
        tables = list(_sections(field))
        inner_name = f"[[{name}.{key}]]" if _is_list(field) else f"{name}.{key}"
        inner += [(table, inner_name) for table in tables]
        if not (kind and key == "kind"):
            yield _row(key, field_name, field, bool(tables))
    yield "\n" + _explained(section) + "\n"
    for table, inner_name in inner:
        yield from _chapter(table, inner_name, "###", shown)


def _row(key: str, field_name: str, field: FieldInfo, is_table: bool) -> str:
    dimension = _dimension(key, field_name, field)
    table = "tables" if _is_list(field) else "a table"
    kinds = None if is_table else _kinds(field)
    if kinds is not None:
        # Kinds without keys, which are written as a name.
        what = ", ".join(dict.fromkeys(_choices(_annotation(each)) for each in kinds.sections()))
        default = _code(field.default.kind)
    else:
        what = table if is_table else dimension or _choices(field.annotation)
        default = _default(field, dimension, is_table)
    if _takes_auto(field):
        what, default = f'{what} or `"auto"`', '`"auto"`'
    if dimension and (words := list(_words(field.annotation))):
        what = " or ".join([what, *(f'`"{word}"`' for word in words)])
    return f"| `{key}` | {what} | {default} | {_bounds(field, dimension)} |"


def _is_list(field: FieldInfo) -> bool:
    return get_origin(field.annotation) is tuple


def _takes_auto(field: FieldInfo) -> bool:
    """Return whether "auto" may be written, which the code represents as None."""
    readers = [part.func for part in field.metadata if isinstance(part, BeforeValidator)]
    with suppress(ValueError, TypeError):
        return any(reader("auto") is None for reader in readers)  # type: ignore[call-arg]
    return False


def _words(annotation: Any) -> Iterator[str]:
    """Yield the words that may stand in place of a number."""
    if get_origin(annotation) is Literal:
        yield from (word for word in get_args(annotation) if isinstance(word, str))
        return
    for part in get_args(annotation):
        yield from _words(part)


def _explained(section: type[Section]) -> str:
    """Return the docstring in one line: its pairs `key: meaning` are about the rows above."""
    return " ".join((section.__doc__ or "").split())


def _annotation(section: type[Section]) -> Any:
    return section.model_fields["kind"].annotation


def _kind(section: type[Section]) -> str | None:
    field = section.model_fields.get("kind")
    values = get_args(field.annotation) if field else ()
    return values[0] if len(values) == 1 else None


def _sections(field: FieldInfo) -> Iterator[type[Section]]:
    """Yield the sections that a field may hold: those of its type, or of telepulse's kinds."""
    kinds = _kinds(field)
    tables = _tables(field.annotation) if kinds is None else kinds.sections()
    yield from (table for table in tables if set(table.model_fields) != {"kind"})


def _kinds(field: FieldInfo) -> OfKind | None:
    return next((part for part in _metadata(field) if isinstance(part, OfKind)), None)


def _tables(annotation: Any) -> Iterator[type[Section]]:
    if isinstance(annotation, type) and issubclass(annotation, Section):
        yield annotation
    for part in get_args(annotation):
        yield from _tables(part)


def _dimension(key: str, field_name: str, field: FieldInfo) -> str | None:
    """Return the dimension by the field's name; a new suffix fails the build."""
    if key != field_name:
        return DIMENSIONS[field_name.removeprefix(f"{key}_")]
    readers = [getattr(part, "func", None) for part in _metadata(field)]
    return _RATIO if parse_ratio in readers else None


def _metadata(field: FieldInfo) -> Iterator[Any]:
    """Return the metadata of a field, also inside `Annotated[...] | None`."""
    yield from field.metadata
    for part in get_args(field.annotation):
        yield from getattr(part, "__metadata__", ())


def _choices(annotation: Any) -> str:
    """Return the permitted values, or their kind."""
    if get_origin(annotation) is Literal:
        return ", ".join(_code(value) for value in get_args(annotation))
    if get_origin(annotation) in (Union, types.UnionType):
        parts = (part for part in get_args(annotation) if part is not type(None))
        return " or ".join(_choices(part) for part in parts)
    if hasattr(annotation, "__metadata__"):
        return _choices(get_args(annotation)[0])
    if get_origin(annotation) is tuple:
        return f"list of {_choices(get_args(annotation)[0])}"
    return _PLAIN[get_origin(annotation) or annotation]


def _default(field: FieldInfo, dimension: str | None, is_table: bool) -> str:
    if field.is_required():
        return "must be given"
    if field.default is None or field.default_factory is not None:
        return "none"
    if field.default == ():
        return "none"
    return "its own defaults" if is_table else _code(_written(field.default, dimension))


def _bounds(field: FieldInfo, dimension: str | None) -> str:
    limits = {
        sign: _written(getattr(part, name), dimension)
        for part in _flat(_metadata(field))
        for name, sign in (("ge", "≥"), ("gt", ">"), ("le", "≤"), ("lt", "<"))
        if getattr(part, name, None) is not None
    }
    return ", ".join(f"{sign} {limit}" for sign, limit in limits.items())


def _flat(parts: Iterator[Any]) -> Iterator[Any]:
    for part in parts:
        yield from part.metadata if isinstance(part, FieldInfo) else (part,)


def _written(value: Any, dimension: str | None) -> Any:
    """Return a value as a scene states it: in the largest unit that leaves at least 1."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    if dimension is None:
        return value if isinstance(value, int) else float(f"{value:g}")
    if dimension == _RATIO:
        return f"{value * 100:g} %"
    si = value * 1e-9 if dimension == "time" else value
    units = {name: size for name, size in UNITS[dimension].items() if name not in ("/min", "min")}
    fitting = [name for name, size in units.items() if abs(si) >= size * 0.999]
    unit = max(fitting, key=units.__getitem__, default=min(units, key=units.__getitem__))
    if si == 0:
        unit = next(name for name, size in units.items() if size == 1)
    return f"{si / units[unit]:.6g} {unit}"


def _code(value: Any) -> str:
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return f'`"{text}"`' if isinstance(value, str) else f"`{text}`"
