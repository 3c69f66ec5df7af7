"""`telepulse record`, `replay` and `export`."""

import sys
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from protocol.cli_options import (
    JsonOption,
    QuietOption,
    StopAfterOption,
    one_line_errors,
    plain_console,
    sum_up,
)
from protocol.host.memory import freeze_objects
from protocol.host.process import allow_connections, stop_on_signals
from protocol.host.result_files import check_writable
from protocol.provenance import collect
from protocol.security.protection import (
    AllowOption,
    InsecureOption,
    KeyOption,
    PeerOption,
    server_keys,
    telemetry_keys,
)
from telepulse.cli.report_options import TablesOption, publish

PROGRAM = "telepulse"
NOT_WHOLE = 1

SilenceOption = Annotated[
    float | None,
    typer.Option(min=0.1, metavar="SECONDS", help="End too when nothing came for so long."),
]
FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="A recording.")]


def record(
    address: Annotated[str, typer.Argument(help="A display's telemetry: tcp://HOST:PORT.")],
    file: Annotated[Path, typer.Argument(metavar="FILE.mcap", help="It must not be there yet.")],
    seconds: StopAfterOption = None,
    until_silent: SilenceOption = None,
    quiet: QuietOption = False,
    key: KeyOption = None,
    peer: PeerOption = None,
    insecure: InsecureOption = False,
    display_pid: Annotated[int | None, typer.Option(hidden=True)] = None,
) -> None:
    """Record all that a display hears and does into an MCAP file, which Foxglove opens.

    Every frame as it came, every tick, the statuses, the stream's description, clock replies and
    what happened. Ends with the display. Killed, it loses at most its last second; a full disk is
    waited for. `display-node --record FILE` starts this beside the display.

    With --key alone, the key is the display's own.

    Exit status: 0 when all was written, 1 when something is missing, which is said, 2 when it
    cannot begin.
    """
    from telepulse.recording.recorder import McapRecorder

    console = plain_console(quiet)
    with one_line_errors(PROGRAM):
        keys = telemetry_keys(address, key, peer, insecure)
        recorder = McapRecorder(address, file, console.print, warn, keys)
    stop_on_signals(recorder.stop)
    if not recorder.run(seconds, until_silent, display_pid):
        raise SystemExit(NOT_WHOLE)


def replay(
    file: FileArgument,
    bind: Annotated[str, typer.Option(help="Address to stream from, as of a sensing node.")] = (
        "tcp://127.0.0.1:5555"
    ),
    seconds: StopAfterOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    key: KeyOption = None,
    allow: AllowOption = None,
    insecure: InsecureOption = False,
) -> None:
    """Play a recording as a sensing node: the same samples, as far apart as they were.

    The stream's name, rate, layer and frames are the recorded ones; samples that the recording
    lacks count as lost. Of several sessions, the longest is played. Any display can listen.

    Exit status: 0 at the end of the recording, 2 when it cannot be read or the address not be
    used; the reason is one line on stderr.
    """
    from sensing_node.node import SensingNode
    from sensing_node.sources.replay import ReplaySource
    from telepulse.recording.session import longest_session

    console = plain_console(quiet)
    with one_line_errors(PROGRAM):
        allow_connections()
        check_writable(json)
        keys = server_keys(bind, key, allow, insecure)
        session = longest_session(file, console.print)
        description = session.description
        source = ReplaySource(description, session.frames())
        node = SensingNode(source, description, bind, log=console.print, keys=keys)
        provenance = collect()
    stop_on_signals(node.stop)
    length_s = session.samples * description.period_ns * 1e-9
    console.print(f"playing {description.name!r} of {file} on {bind}: {length_s:.1f} s")
    freeze_objects()
    summary = node.run(seconds)
    sum_up(PROGRAM, summary, "replay", console, json, provenance)


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
        export_to(file, out or file.with_suffix(suffix), plain_console().print)


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
    from telepulse.recording.report.chapters import build_recording_report

    folder = out or file.with_name(f"{file.stem}-report")
    publish(lambda: build_recording_report(file), folder, json)


def warn(text: str) -> None:
    """Say it on stderr."""
    with suppress(OSError):  # who listens may have gone before the recorder
        print(f"{PROGRAM}: {text}", file=sys.stderr)
