"""`telepulse export`."""

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from protocol.cli_options import one_line_errors, plain_console
from telepulse.cli.options import PROGRAM, FileArgument


class TableKind(Enum):
    """The kinds of export of a recording."""

    CSV = "csv"
    PARQUET = "parquet"
    EDF = "edf"
    MCAP = "mcap"


def export(
    file: FileArgument,
    to: Annotated[
        TableKind,
        typer.Option(
            help="csv, parquet: a table a topic; edf: the forces as signals; mcap: a whole file."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="A folder for tables, else a file; not there yet."),
    ] = None,
) -> None:
    """Write a recording as tables, as signals, or one that was cut short as a whole file.

    csv, parquet: samples, ticks, clock and events in a new folder. edf: force at the wrist and
    force felt of the longest session as EDF+, events and losses as annotations. mcap: what can be
    read of a recording whose recorder was killed, with the index that Foxglove needs.
    """
    from telepulse.recording.edf import export_edf
    from telepulse.recording.export import export_csv, export_mcap, export_parquet

    export_to, suffix = {
        TableKind.CSV: (export_csv, ""),
        TableKind.PARQUET: (export_parquet, ".parquet"),
        TableKind.EDF: (export_edf, ".edf"),
        TableKind.MCAP: (export_mcap, ".whole.mcap"),
    }[to]
    with one_line_errors(PROGRAM):
        plain_console().print(export_to(file, out or file.with_suffix(suffix)))
