"""`telepulse report`."""

from pathlib import Path
from typing import Annotated

import typer

from telepulse.cli.options import FileArgument, TablesOption, publish


def report(
    file: FileArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Write it here; else beside the file.")
    ] = None,
    json: TablesOption = None,
) -> None:
    """Write a report of a recording: figures, forces, delays, loss, clocks, loop, heart rate.

    A page with plots, by default in the folder FILE-report, and its tables in the terminal. The
    figures are computed from what was recorded, and stand beside the display's own.
    """
    from telepulse.recording.report import build_recording_report

    folder = out or file.with_name(f"{file.stem}-report")
    publish(lambda: build_recording_report(file), folder, json)
