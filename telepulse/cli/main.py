"""The command line of telepulse, assembled from its commands.

To add a command, write its function in a module of this package and name it in `LIVE` or `OTHERS`;
name a module of sub-commands in `GROUPS`.
"""

from collections.abc import Callable

import typer

from protocol.cli_options import VersionOption
from protocol.host.output import configure_logging, unblocked_output
from telepulse.cli import emulate, experiment, keys, scenes, study
from telepulse.cli.commissioning import bench, calibrate, tune
from telepulse.cli.demo import demo, simulate
from telepulse.cli.discover import discover
from telepulse.cli.link import link, relay
from telepulse.cli.options import PROGRAM
from telepulse.cli.paper import paper
from telepulse.cli.record import export, record, replay, report
from telepulse.cli.view import lsl, view

# Commands that run beside nodes or as one: a terminal that is not read must not delay them.
LIVE: tuple[Callable[..., None], ...] = (demo, link, bench, relay, record, replay, view, lsl)
OTHERS = (simulate, paper, tune, calibrate, discover, export, report)
GROUPS = (scenes, study, emulate, experiment, keys)

app = typer.Typer(rich_markup_mode="markdown", no_args_is_help=True)
for live in LIVE:
    app.command()(unblocked_output()(live))
for command in OTHERS:
    app.command()(command)
for group in GROUPS:
    app.add_typer(group.app, name=group.__name__.rpartition(".")[2])


@app.callback(
    help="A pulse sensed in one place, felt in another: demo, simulation and link emulation."
)
def telepulse(version: VersionOption = False) -> None:
    """Take the options that stand before a command."""


def main() -> None:
    """Run `telepulse`."""
    configure_logging()
    app(prog_name=PROGRAM)
