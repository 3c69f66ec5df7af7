"""Command-line option of real-time measures, and the lines that report on them."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated

import typer
from rich.console import Console

from protocol.cli_options import one_line_errors
from protocol.host.realtime_grant import RealtimeGrant, hold
from protocol.host.realtime_request import RealtimeRequest

RealtimeOption = Annotated[
    str | None,
    typer.Option(
        metavar="fifo=40,lock,cpu=1,slack",
        help="Ask the system for these, or some of them, so that the loop is on time; what is not"
        " granted is said, and done without. With 'strict' the node does not start then.",
    ),
]


@contextmanager
def granted_for(program: str, asked: RealtimeRequest, console: Console) -> Iterator[RealtimeGrant]:
    """Take the measures as `hold` does; print what is granted, and on stderr what is not."""

    def warn(line: str) -> None:
        print(f"{program}: {line}", file=sys.stderr)

    with one_line_errors(program), hold(asked, warn) as held:
        if held.granted:
            console.print(str(held))
        for refusal in held.refused:
            warn(str(refusal))
        yield held
