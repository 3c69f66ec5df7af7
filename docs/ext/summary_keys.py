"""The keys of the summary, from the dataclasses it is made of."""

import dataclasses
from collections.abc import Iterator
from typing import Any, get_type_hints

from protocol.run_summary import Summary


def write() -> str:
    """A table of every key, inner ones behind a dot, with its type."""
    rows = (f"| `{key}` | {kind} |" for key, kind in keys(Summary))
    return "\n".join(["| key | what it is |", "|---|---|", *rows])


def keys(table: Any, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Each key of a dataclass and of those inside it, and what its value is."""
    hints = get_type_hints(table)
    for field in dataclasses.fields(table):
        hint, key = hints[field.name], prefix + field.name
        if dataclasses.is_dataclass(hint):
            yield from keys(hint, f"{key}.")
        else:
            yield key, _kind(hint)


def _kind(hint: Any) -> str:
    names = {
        int | None: "whole number or null",
        float | None: "number or null",
        bool | None: "true, false or null",
        str | None: "text or null",
        list[str]: "list of texts",
        dict[str, int]: "map of name to count",
    }
    return names[hint]
