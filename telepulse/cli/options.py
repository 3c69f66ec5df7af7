"""Options and steps that several commands of telepulse share."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from protocol.cli_options import one_line_errors, plain_console
from protocol.config.scene_file import scene_names
from protocol.host.output import check_writable
from protocol.provenance import collect
from telepulse.document import (
    Report,
    check_can_report,
    print_tables,
    write_json,
    write_report,
)

PROGRAM = "telepulse"
# The tip's own rubber is ten times harder than a finger: the dummy is of gel.
KEEP_AWAY = "Keep fingers away: put a dummy of gel in the finger's place."
# Exit status of a recorder or an outlet that missed telemetry.
NOT_WHOLE = 1

SceneArgument = Annotated[
    str,
    typer.Argument(
        help="A scene file, or the name of one that comes with telepulse.",
        autocompletion=scene_names,
    ),
]
FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="A recording.")]
AddressArgument = Annotated[str, typer.Argument(help="A display's telemetry: tcp://HOST:PORT.")]
ContactorOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Of several [[display.contactor]] tables, the one of NAME."),
]
YesOption = Annotated[bool, typer.Option("--yes", help="Do not ask before the drive moves.")]
PageOption = Annotated[
    Path | None, typer.Option(metavar="FOLDER", help="Write a page with plots here.")
]
LinkOption = Annotated[
    str | None,
    typer.Option(
        metavar="'delay=40ms,jitter=10ms,loss=1%'",
        help="Impairments of the link between the nodes, in place of the scene's [link]. The keys,"
        " such as burst_loss, rate, cut.from and transport, are in docs/scenes.md.",
    ),
]
SeedOption = Annotated[int, typer.Option(min=0, help="Seed of the link's random impairments.")]
SilenceOption = Annotated[
    float | None,
    typer.Option(min=0.1, metavar="SECONDS", help="End also when nothing has come for this time."),
]
FolderOption = Annotated[Path, typer.Option(metavar="FOLDER", help="Write the report here.")]
TablesOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Write the tables here as JSON; -: print it alone."),
]


def publish(build: Callable[[], Report], out: Path | None, json: Path | None) -> None:
    """Build a report, write its page into `out` and its tables to `json`, and print them.

    Without `out` no page is written, and matplotlib is not needed. Paths that cannot be written
    are refused before the report is computed.
    """
    console = plain_console(json=json)
    with one_line_errors(PROGRAM):
        check_writable(json)
        if out is not None:
            check_can_report(out)
        # Before the report is computed: the provenance has the time at which the command started.
        provenance = collect()
        report = build()
        if report.provenance is None:
            report = replace(report, provenance=provenance)
        page = None if out is None else write_report(report, out)
        if json is not None:
            write_json(report, json)
        print_tables(report, console)
    if page is not None:
        console.print(f"report: {page}")
