"""Command lines of the nodes: options, metrics, verdict and figures of a run."""

import logging
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from protocol.errors import DriveError, TelepulseError
from protocol.faults import FaultKind
from protocol.host.child_process import Sidecar, sidecar_module
from protocol.host.output import STDOUT, escaped
from protocol.host.realtime import RealtimeGrant, RealtimeRequest, apply_realtime
from protocol.provenance import Provenance
from protocol.security.allow_list import FILE_NAME
from protocol.sockets import beyond_loopback
from protocol.summary.fields import Summary
from protocol.summary.rows import print_summary, write_json

logger = logging.getLogger(__name__)

NO_ANSWER = 1
USAGE_ERROR = 2
# Exit status of a node, or of a demo, that ended at a latched fault.
FAULT_STATUS = 3
LONGEST_S = 1e9
BENCH_IS_CLEAR = "Is the bench clear of fingers?"

StopAfterOption = Annotated[
    float | None, typer.Option(min=0.1, max=LONGEST_S, help="Stop after this long; else at Ctrl-C.")
]
DurationOption = Annotated[float, typer.Option(min=1, max=LONGEST_S, help="Seconds of pulse.")]
SourceOption = Annotated[
    Path | None,
    typer.Option(
        metavar="RECORD",
        help="Play this file in place of the scene's source: a WFDB record (PhysioNet), EDF, XDF,"
        " MCAP, Parquet, CSV, NumPy or WAV.",
    ),
]
RecordChannelOption = Annotated[
    str | None,
    typer.Option(
        "--channel",
        metavar="NAME",
        help="Name or number of the signal of --source to play. Default: the one with"
        " the shape of a pulse.",
    ),
]
RecordRateOption = Annotated[
    str | None,
    typer.Option(
        "--rate",
        metavar="'500 Hz'",
        help="Rate of --source; it overrides that of the file.",
    ),
]
RecordPreloadOption = Annotated[
    str | None,
    typer.Option(
        "--preload",
        metavar="'0.3 N'",
        help="Force added to that of --source, so that it stays above 0 N.",
    ),
]
AboutOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="KEY=TEXT",
        help="State subject, position, side or notes of the recording, once for each.",
    ),
]
JsonOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE", help="Write the figures of the run here as JSON; -: print them alone."
    ),
]


DetailsOption = Annotated[
    bool, typer.Option("--details", help="Print every figure of the run below the verdict on it.")
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
    bool, typer.Option("--quiet", help="Print no summary; log only warnings and errors.")
]
PredictorOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Predictor in place of the scene's: hold, linear, fir, analogue or stack.",
    ),
]
CompensationOption = Annotated[
    str | None,
    typer.Option(
        metavar="TIME|auto|shape",
        help="Perceived delay in place of the scene's, such as '80 ms'. auto: the one nearest to"
        " the present pulse at which a finger seldom notices an error. shape: the smallest at which"
        " the prediction changes no shape.",
    ),
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
        help="Real-time measures that keep the loop on time; give all or some. The node reports"
        " what is not granted and runs without it; with 'strict' it refuses to start.",
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
        " its public key. Without SCENE: list all nodes.",
    ),
]
NamedOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Choose this one of several that --discover finds."),
]
KeyOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.key", help="This node's secret key; make one by: telepulse keys new NAME."
    ),
]
PeerOption = Annotated[
    Path | None, typer.Option(metavar="FILE.pub", help="Public key of the node to connect to.")
]
AllowOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Allow-list: a file of the public keys that may connect. Default: the file"
        f" '{FILE_NAME}' beside the key.",
    ),
]
InsecureOption = Annotated[
    bool, typer.Option("--insecure", help="Permit links beyond this machine without keys.")
]
MetricsOption = Annotated[
    str | None,
    typer.Option(
        metavar="[ADDRESS:]PORT",
        help="Serve this node's figures to Prometheus over HTTP, on this machine alone unless an"
        " address is given; port 0 picks a free one.",
    ),
]


@contextmanager
def one_line_errors(program: str) -> Iterator[None]:
    """Turn the project's own errors into one line on stderr and exit status 2.

    A drive that an unexpected exception keeps from starting is a fault, with exit status 3. A
    question that is not answered ends the program with exit status 1.
    """
    try:
        yield
    except typer.Abort:
        # At Ctrl-C, or without a terminal; the question's line has not ended.
        print(f"\n{program}: there was no answer", file=sys.stderr)
        raise SystemExit(NO_ANSWER) from None
    except TelepulseError as error:
        print(f"{program}: {escaped(str(error))}", file=sys.stderr)
        failed = isinstance(error, DriveError) and error.kind is FaultKind.INTERNAL
        raise SystemExit(FAULT_STATUS if failed else USAGE_ERROR) from None


def plain_console(quiet: bool = False, json: Path | None = None) -> Console:
    """Return a console that prints text uncut and without markup, since peers may send text.

    It prints nothing where `quiet`, or where the command's JSON goes to standard output.
    """
    return Console(quiet=quiet or json == STDOUT, markup=False, emoji=False, soft_wrap=True)


def sum_up(
    program: str,
    summary: Summary,
    title: str,
    console: Console,
    json: Path | None,
    provenance: Provenance,
    verdict: Sequence[str] = (),
    details: bool = True,
) -> None:
    """Print the verdict on a run and its figures; write these to the file `json`, if any.

    provenance: of the run, for the file. verdict: lines that come first. The figures are printed
    with `details` only.
    """
    hint = "" if details else " (every figure: --details)"
    console.print(f"{title}{hint}", *(f"  {line}" for line in verdict), sep="\n")
    if details:
        print_summary(summary, console)
    if json is not None:
        with one_line_errors(program):
            write_json(summary, json, provenance)


def fault_status(program: str, summary: Summary) -> int:
    """Name a run's latched faults on stderr, with remedies; return the exit status, 0 for none."""
    for fault in summary.faults:
        print(f"{program}: ended at the fault {str(fault)!r}: {fault.remedy}", file=sys.stderr)
    return FAULT_STATUS if summary.faults else 0


@contextmanager
def apply_and_log_realtime(program: str, request: RealtimeRequest) -> Iterator[RealtimeGrant]:
    """Apply the settings as `apply_realtime` does; log those granted and those refused."""
    with one_line_errors(program), apply_realtime(request) as grant:
        if grant.granted:
            logger.info(str(grant))
        for refusal in grant.refused:
            logger.warning(str(refusal))
        yield grant


def with_realtime_settings(summary: Summary, grant: RealtimeGrant) -> Summary:
    """Return a loop's summary with the names of the settings that were granted."""
    return replace(summary, loop=replace(summary.loop, realtime=list(grant.granted)))


@contextmanager
def start_metrics(program: str, where: str | None) -> Iterator[Sidecar | None]:
    """Start a process that serves metrics at `where` within a `with`; yield it, or None.

    where: address and port; None starts nothing. Enter it before a drive moves. Then send the
    process the `address` of the telemetry and the node's own `key` (None without keys). Raises
    SidecarError where the port is taken, or the library or the package is missing.
    """
    if where is None:
        yield None
        return
    with Sidecar("metrics server", sidecar_module("metrics"), program, where) as sidecar:
        url = sidecar.ready_message
        logger.info(f"metrics on {url}")
        if beyond_loopback(url.replace("http", "tcp", 1).removesuffix("/metrics")):
            logger.warning(
                "all who can reach that port can read them: HTTP has neither keys nor encryption"
            )
        yield sidecar
