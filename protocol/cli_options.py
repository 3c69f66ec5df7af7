"""Command lines of the nodes: options, keys of protected links, metrics, closing summary."""

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

from protocol.errors import ProtectionError, TelepulseError
from protocol.host.child_process import Sidecar, sidecar_module
from protocol.host.output import STDOUT
from protocol.host.realtime import RealtimeGrant, RealtimeRequest, apply_realtime
from protocol.provenance import Provenance
from protocol.security.allow_list import read_allowed
from protocol.security.keys import ClientKeys, ServerKeys, read_pair, read_public
from protocol.sockets import beyond_loopback, control_address
from protocol.summary.rows import print_summary, write_json
from protocol.summary.tables import Summary

logger = logging.getLogger(__name__)

USAGE_ERROR = 2
# Exit status of a node, or of a demo, that ended at a latched fault.
FAULT_STATUS = 3
LONGEST_S = 1e9
ALLOWED = "allowed"
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
        help="Name or number of the signal of --source to play. Default: the first that is a"
        " pulse by its name or unit.",
    ),
]
RecordRateOption = Annotated[
    str | None,
    typer.Option(
        "--rate",
        metavar="'500 Hz'",
        help="Rate of --source where the file states none, such as an .npy.",
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
    typer.Option(metavar="FILE", help="Write the closing summary here as JSON; -: print it alone."),
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
        metavar="TIME|auto",
        help="Perceived delay in place of the scene's, such as '80 ms'. auto: the smallest at which"
        " the predictor's error goes unnoticed, or at which samples arrive.",
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
        help="Allow-list: a file of the public keys that may connect. Default: the file 'allowed'"
        " beside the key.",
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
    """Turn the project's own errors into one line on stderr and exit status 2."""
    try:
        yield
    except TelepulseError as error:
        print(f"{program}: {error}", file=sys.stderr)
        raise SystemExit(USAGE_ERROR) from None


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
    """Print the closing summary; write it to the file `json`, if any, with its provenance.

    verdict: lines that come before the figures, which are printed with `details` only.
    """
    hint = "" if details else " (every figure: --details)"
    console.print(f"{title}{hint}", *(f"  {line}" for line in verdict), sep="\n")
    if details:
        print_summary(summary, console)
    if json is not None:
        with one_line_errors(program):
            write_json(summary, json, provenance)


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


def server_keys(
    address: str, key: Path | None, allow: Path | None, insecure: bool
) -> ServerKeys | None:
    """Return the keys for sockets bound to `address`; None for a link without keys.

    Raises ProtectionError where keys are required or the options do not fit; KeyFileError.
    """
    if key is None and allow is not None:
        raise ProtectionError(f"--allow {allow} needs this node's own key: --key FILE.key")
    _check_insecure(key is not None, [address], insecure, "--key keys/NAME.key")
    if key is None:
        return None
    if allow is not None and not allow.exists():
        raise ProtectionError(f"--allow {allow}: there is no such file")
    allowed = allow or key.with_name(ALLOWED)
    read_allowed(allowed)
    return ServerKeys(read_pair(key), allowed)


def client_keys(
    addresses: Sequence[str], key: Path | None, peer: Path | None, insecure: bool
) -> ClientKeys | None:
    """Return the keys for sockets that connect to `addresses`; None for a link without keys.

    Raises ProtectionError where keys are required or the options do not fit; AddressError;
    KeyFileError.
    """
    for address in addresses:
        control_address(address)
    keyed = key is not None or peer is not None
    _check_insecure(keyed, addresses, insecure, "--key keys/NAME.key --peer keys/PEER.pub")
    if not keyed:
        return None
    if key is None:
        raise ProtectionError(f"--peer {peer} needs this node's own key: --key FILE.key")
    if peer is None:
        raise ProtectionError(f"--key {key} needs the other node's public key: --peer FILE.pub")
    return ClientKeys(read_pair(key), read_public(peer))


def telemetry_keys(
    address: str, key: Path | None, peer: Path | None, insecure: bool
) -> ClientKeys | None:
    """Return the keys for reading a display's telemetry.

    A key without a peer is the display's own. Raises as `client_keys` does.
    """
    if key is not None and peer is None:
        pair = read_pair(key)
        return ClientKeys(pair, pair.public)
    return client_keys([address], key, peer, insecure)


def _check_insecure(keyed: bool, addresses: Sequence[str], insecure: bool, options: str) -> None:
    """Check that a link has keys, stays on this machine, or is explicitly insecure."""
    if keyed and insecure:
        raise ProtectionError("--insecure does without keys, and --key is given: choose one")
    for address in addresses:
        if beyond_loopback(address) and not keyed and not insecure:
            raise ProtectionError(
                f"{address} reaches beyond this machine without keys; make them by"
                f" 'telepulse keys new NAME' and give {options}, or give --insecure"
            )


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
