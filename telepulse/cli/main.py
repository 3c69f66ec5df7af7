"""The command line of telepulse, assembled from its commands.

To add a command, write its function in a module of this package and name the module in `PANELS`,
under what a person wants to do. A module of sub-commands is one of `GROUPS` besides.
"""

from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup

from protocol.cli_options import VersionOption
from protocol.host.output import configure_logging, unblocked_output
from telepulse.cli.options import PROGRAM

# The panels of the help, and the module of each of their commands.
PANELS = {
    "Run": {"demo": "demo", "simulate": "demo", "view": "view", "scenes": "scenes"},
    "Bring hardware into service": {
        "bench": "commissioning",
        "calibrate": "commissioning",
        "tune": "commissioning",
        "sweep": "sweep",
        "emulate": "emulate",
    },
    "Record and analyse": {
        "record": "record",
        "mark": "record",
        "replay": "record",
        "report": "record",
        "export": "record",
    },
    "Networks": {
        "keys": "keys",
        "relay": "link",
        "link": "link",
    },
    "Research": {"experiment": "experiment", "study": "study", "paper": "paper"},
}
MODULES = {name: module for commands in PANELS.values() for name, module in commands.items()}
PANEL_OF = {name: panel for panel, commands in PANELS.items() for name in commands}
GROUPS = {"scenes", "study", "emulate", "experiment", "keys"}
# Commands that run beside nodes or as one: a terminal that is not read must not delay them.
LIVE = {"demo", "link", "bench", "relay", "record", "mark", "replay", "view", "sweep"}


class LazyGroup(TyperGroup):
    """Group that imports a command's module when the command is used; all take half a second."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = dict.fromkeys(MODULES)  # type: ignore[assignment]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command; None where there is none of that name."""
        if cmd_name not in MODULES:
            return None
        module = import_module(f"{__package__}.{MODULES[cmd_name]}")
        loaded = typer.Typer(rich_markup_mode="markdown")
        panel = PANEL_OF[cmd_name]
        if cmd_name in GROUPS:
            loaded.add_typer(module.app, name=cmd_name, rich_help_panel=panel)
        else:
            function = getattr(module, cmd_name)
            if cmd_name in LIVE:
                function = unblocked_output()(function)
            loaded.command(rich_help_panel=panel)(function)
        return typer.main.get_group(loaded).commands[cmd_name]


app = typer.Typer(cls=LazyGroup, rich_markup_mode="markdown", no_args_is_help=True)


@app.callback(
    help="A pulse sensed in one place, felt in another.\n\n"
    "The two nodes are programs of their own: `sensing-node` at the wrist and `display-node` at the"
    " finger. `telepulse` runs both for a demo, brings their hardware into service, and analyses"
    " what they did."
)
def telepulse(version: VersionOption = False) -> None:
    """Take the options that stand before a command."""


def main() -> None:
    """Run `telepulse`."""
    configure_logging()
    app(prog_name=PROGRAM)
