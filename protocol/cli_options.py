"""Common parts of the command lines: options, one way to fail, one way to sum up."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from protocol.errors import TelepulseError
from protocol.provenance import Provenance
from protocol.run_summary import Summary, print_summary, write_json

USAGE_ERROR = 2
LONGEST_S = 1e9
BENCH_IS_CLEAR = "Is the bench clear of fingers?"

StopAfterOption = Annotated[
    float | None,
    typer.Option(min=0.1, max=LONGEST_S, help="Stop after this long; else at Ctrl-C."),
]
DurationOption = Annotated[float, typer.Option(min=1, max=LONGEST_S, help="Seconds of pulse.")]
JsonOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Write the closing summary here as JSON.")
]


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"telepulse {version('telepulse')}")
        raise typer.Exit


VersionOption = Annotated[
    bool,
    typer.Option(
        "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
    ),
]
QuietOption = Annotated[bool, typer.Option("--quiet", help="Print nothing but errors.")]


@contextmanager
def one_line_errors(program: str) -> Iterator[None]:
    """Turn the project's own errors into one line on stderr and exit status 2."""
    try:
        yield
    except TelepulseError as error:
        print(f"{program}: {error}", file=sys.stderr)
        raise SystemExit(USAGE_ERROR) from None


def plain_console(quiet: bool = False) -> Console:
    """A console that prints what it is given: text from peers is no markup, lines are not cut."""
    return Console(quiet=quiet, markup=False, emoji=False, soft_wrap=True)


def sum_up(
    program: str,
    summary: Summary,
    title: str,
    console: Console,
    json: Path | None,
    provenance: Provenance,
) -> None:
    """Print the closing summary, and write it where asked, with what produced it."""
    print_summary(summary, title, console)
    if json is not None:
        with one_line_errors(program):
            write_json(summary, json, provenance)
