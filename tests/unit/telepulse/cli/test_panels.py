"""The commands of telepulse, grouped by what a person wants to do."""

import typer
from typer.core import TyperGroup
from typer.testing import CliRunner

from telepulse.cli.main import PANELS, app


def test_each_command_is_in_one_panel_of_the_help() -> None:
    group = typer.main.get_command(app)
    assert isinstance(group, TyperGroup)
    context = group.context_class(group)
    names = group.list_commands(context)
    assert len(names) == len(set(names))
    for name in names:
        command = group.get_command(context, name)
        panels = [panel for panel, commands in PANELS.items() if name in commands]
        assert [getattr(command, "rich_help_panel", None)] == panels, name


def test_the_help_shows_the_panels_in_order() -> None:
    shown = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "80"}).stdout
    places = [shown.index(f" {panel} ") for panel in PANELS]
    assert places == sorted(places)
    assert " Commands " not in shown
