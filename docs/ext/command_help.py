"""The `--help` of a command and its sub-commands, as a page."""

import re
from collections.abc import Iterator
from typing import Any

import typer
from typer.core import TyperGroup

from docs.ext.pages import load

# What a help text ends with where there is a default or a range.
_LIMITS = re.compile(r"\s*\[((?:default|required|env var|[-0-9.e+x]+[<>]=?)[^\]]*)\]$")


def write(target: str, program: str) -> str:
    """Return usage, text, arguments and options of the typer application at `target`."""
    app = load(target)
    assert isinstance(app, typer.Typer)
    return "\n".join(_chapter(typer.main.get_command(app), program, "##"))


def _chapter(command: Any, name: str, level: str) -> Iterator[str]:
    context = command.context_class(command, info_name=name)
    yield f"{level} {name}\n"
    yield f"{command.help}\n"
    if isinstance(command, TyperGroup):
        yield from _panels(command, context, name)
        for inner_name in command.list_commands(context):
            inner = command.get_command(context, inner_name)
            yield from _chapter(inner, f"{name} {inner_name}", "###")
        return
    usage = " ".join(command.get_usage(context).removeprefix("Usage: ").split())
    yield f"```text\n{usage}\n```\n"
    records = [record for part in command.params if (record := part.get_help_record(context))]
    if records:
        yield "| | | default, range |\n|---|---|---|"
        yield from (_row(*record) for record in records)
        yield ""


def _panels(group: TyperGroup, context: Any, name: str) -> Iterator[str]:
    """Yield a table of the commands by the panels of the help; nothing where there are none."""
    panels: dict[str, list[str]] = {}
    for inner_name in group.list_commands(context):
        panel = getattr(group.get_command(context, inner_name), "rich_help_panel", None)
        if isinstance(panel, str):
            anchor = f"{name} {inner_name}".replace(" ", "-")
            panels.setdefault(panel, []).append(f"[`{inner_name}`](#{anchor})")
    if panels:
        yield "| to | commands |\n|---|---|"
        yield from (f"| {panel.lower()} | {', '.join(links)} |" for panel, links in panels.items())
        yield ""


def _row(name: str, text: str) -> str:
    limits = _LIMITS.search(text)
    cells = (f"`{name}`", _LIMITS.sub("", text), f"`{limits[1]}`" if limits else "")
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"
