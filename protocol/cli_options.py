"""Common parts of the nodes' command lines: options, errors, closing summary."""

import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from protocol.errors import TelepulseError
from protocol.host.realtime import RealtimeGrant, RealtimeRequest, hold
from protocol.provenance import Provenance
from protocol.run_summary import Summary, print_summary, write_json

logger = logging.getLogger(__name__)

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
QuietOption = Annotated[
    bool,
    typer.Option("--quiet", help="Print no summary; log only warnings and errors."),
]
LogLevelOption = Annotated[
    str | None,
    typer.Option(
        metavar="LEVEL",
        help="Log to stderr from this level on: debug, info, warning or error. Default: info, and"
        " warning where the command is --quiet.",
    ),
]
RealtimeOption = Annotated[
    str | None,
    typer.Option(
        metavar="fifo=40,lock,cpu=1,slack",
        help="Real-time measures that keep the loop on time, or some of them; the node reports"
        " what is not granted and runs without it. With 'strict' it does not start then.",
    ),
]
AnnounceOption = Annotated[
    bool,
    typer.Option(
        "--announce",
        help="Announce this node on the local network, for display-node --discover: its stream's"
        " and this machine's name, its ports and its key's fingerprint.",
    ),
]
DiscoverOption = Annotated[
    bool,
    typer.Option(
        "--discover",
        help="Find the sensing node on the local network, instead of --connect; --peer still gives"
        " its public key.",
    ),
]
NamedOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Choose this one of several that --discover finds."),
]


def level_options(log_level: str | None, quiet: bool) -> list[str]:
    """Return the options with which another program of ours logs as this one does."""
    level = [] if log_level is None else ["--log-level", log_level]
    return [*level, *(["--quiet"] if quiet else [])]


@contextmanager
def one_line_errors(program: str) -> Iterator[None]:
    """Turn the project's own errors into one line on stderr and exit status 2."""
    try:
        yield
    except TelepulseError as error:
        print(f"{program}: {error}", file=sys.stderr)
        raise SystemExit(USAGE_ERROR) from None


def plain_console(quiet: bool = False) -> Console:
    """Return a console that prints text as it is: without markup, as peers send text, uncut."""
    return Console(quiet=quiet, markup=False, emoji=False, soft_wrap=True)


def sum_up(
    program: str,
    summary: Summary,
    title: str,
    console: Console,
    json: Path | None,
    provenance: Provenance,
) -> None:
    """Print the closing summary; write it to the file `json`, if any, with its provenance."""
    print_summary(summary, title, console)
    if json is not None:
        with one_line_errors(program):
            write_json(summary, json, provenance)


@contextmanager
def hold_measures(program: str, request: RealtimeRequest) -> Iterator[RealtimeGrant]:
    """Take the measures as `hold` does; log those granted and those refused."""
    with one_line_errors(program), hold(request) as grant:
        if grant.granted:
            logger.info(str(grant))
        for refusal in grant.refused:
            logger.warning(str(refusal))
        yield grant


def with_measures(summary: Summary, grant: RealtimeGrant) -> Summary:
    """Return a loop's summary with the names of the measures that were granted."""
    return replace(summary, loop=replace(summary.loop, realtime=list(grant.granted)))
