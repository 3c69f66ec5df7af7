"""The command line of telepulse, assembled from its commands.

To add a command, write its function in a module of this package and name the module in `LIVE` or
`OTHERS`; name a module of sub-commands in `GROUPS`.
"""

from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup

from protocol.cli_options import VersionOption
from protocol.host.output import configure_logging, unblocked_output
from telepulse.cli.options import PROGRAM

# Commands that run beside nodes or as one: a terminal that is not read must not delay them.
LIVE = {"demo": "demo", "link": "link", "bench": "commissioning", "relay": "link", "tunnel": "link"}
LIVE |= {"record": "record", "mark": "record", "replay": "record", "view": "view", "lsl": "view"}
LIVE |= {"sweep": "sweep"}
OTHERS = {"simulate": "demo", "paper": "study", "tune": "commissioning"}
OTHERS |= {"calibrate": "commissioning", "discover": "discover"}
OTHERS |= {"export": "record", "convert": "record", "report": "record", "plugins": "plugins"}
GROUPS = {name: name for name in ("scenes", "study", "emulate", "experiment", "keys")}
MODULES = LIVE | OTHERS | GROUPS


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
        if cmd_name in GROUPS:
            loaded.add_typer(module.app, name=cmd_name)
        else:
            function = getattr(module, cmd_name)
            loaded.command()(unblocked_output()(function) if cmd_name in LIVE else function)
        return typer.main.get_group(loaded).commands[cmd_name]


app = typer.Typer(cls=LazyGroup, rich_markup_mode="markdown", no_args_is_help=True)


@app.callback(help="A pulse sensed in one place, felt in another: demo, simulation and link proxy.")
def telepulse(version: VersionOption = False) -> None:
    """Take the options that stand before a command."""


def main() -> None:
    """Run `telepulse`."""
    configure_logging()
    app(prog_name=PROGRAM)
