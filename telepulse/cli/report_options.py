"""Common parts of the commands that make a report: check, build, write, print."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from protocol.cli_options import one_line_errors, plain_console
from protocol.host.result_files import check_writable
from protocol.provenance import collect
from telepulse.reports.document import (
    Report,
    check_can_report,
    print_tables,
    write_json,
    write_report,
)

PROGRAM = "telepulse"
FolderOption = Annotated[Path, typer.Option(metavar="FOLDER", help="Write the report here.")]
TablesOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Write the tables here as JSON.")
]


def publish(build: Callable[[], Report], out: Path | None, json: Path | None) -> None:
    """Build a report, write its page into `out` and its tables to `json`, and print them.

    Without `out` there is no page, and nothing to draw it is needed. What cannot be written is
    said before the work.
    """
    console = plain_console()
    with one_line_errors(PROGRAM):
        check_writable(json)
        if out is not None:
            check_can_report(out)
        # Once, before the work: the start is the command's.
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
