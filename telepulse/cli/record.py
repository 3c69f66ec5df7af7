"""`telepulse record`, `mark`, `replay`, `export` and `report`: make recordings and use them.

`display-node --record` runs this module as its recorder.
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer

from protocol.cli_options import (
    AboutOption,
    AllowOption,
    InsecureOption,
    JsonOption,
    KeyOption,
    LogLevelOption,
    PeerOption,
    QuietOption,
    StopAfterOption,
    one_line_errors,
    plain_console,
    sum_up,
)
from protocol.errors import OutputError
from protocol.host.output import check_writable, configure_logging, unblocked_output
from protocol.host.process import freeze_objects, raise_file_limit, stop_on_signals
from protocol.provenance import collect
from protocol.security.link_keys import ClientKeys, KeyOptions
from telepulse.cli.options import (
    NOT_WHOLE,
    PROGRAM,
    AddressArgument,
    FileArgument,
    SilenceOption,
    TablesOption,
    publish,
)

logger = logging.getLogger(__name__)

MARKED_WITHIN_S = 5.0


def record(
    address: AddressArgument,
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE.mcap]", help="The recording; the file must not exist yet."),
    ] = None,
    lsl: Annotated[
        bool,
        typer.Option(
            "--lsl",
            help="Publish to the Lab Streaming Layer instead, for LabRecorder: forces of the wrist"
            " and of the finger, and events.",
        ),
    ] = False,
    seconds: StopAfterOption = None,
    until_silent: SilenceOption = None,
    about: AboutOption = None,
    marks: Annotated[
        bool,
        typer.Option("--marks", help="Mark the time at each line of standard input: type Enter."),
    ] = False,
    marks_from: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Mark the texts of this LSL stream."),
    ] = None,
    quiet: QuietOption = False,
    log_level: LogLevelOption = None,
    key: KeyOption = None,
    peer: PeerOption = None,
    insecure: InsecureOption = False,
    display_pid: Annotated[int | None, typer.Option(hidden=True)] = None,
    recorder_name: Annotated[str | None, typer.Option(hidden=True)] = None,
) -> None:
    """Record all that a display receives and does into an MCAP file, which Foxglove opens.

    Records every frame as received, every tick, statuses, stream description, clock replies and
    events. Ends with the display. If killed, it loses at most its last second; on a full disk it
    waits for space. `display-node --record FILE` starts this command beside the display.

    With --marks, Enter in this terminal marks the present time, with the text before it if there is
    one; a program can write such lines into a pipe. Marks are events of the recording, and the
    display shows them to all readers of its telemetry; --about is kept in the file's metadata
    alone. Neither is sent to the sensing node.

    --lsl writes no file. It publishes three streams: "telepulse wrist", the force of each channel
    as it came; "telepulse finger", target and felt force of each tick; "telepulse events", events
    as markers.

    --key is the display's own key file. With another key, give the display's public key as --peer.

    Exit status: 0 when all was written, 1 when something is missing, which it prints, 2 when it
    cannot begin.
    """
    from telepulse.recording.marks import LineMarks, LslMarks, MarkSource, read_about
    from telepulse.recording.recorder import TelemetryRecorder

    with one_line_errors(PROGRAM):
        configure_logging(log_level, quiet)
        keys = KeyOptions(key, peer, insecure=insecure).telemetry_client(address)
        if lsl == (file is not None) or (lsl and (about or marks or marks_from)):
            raise OutputError(
                "give FILE.mcap, or --lsl; marks and --about are kept in a recording alone"
            )
        if file is None:
            _publish_to_lsl(address, keys, seconds, until_silent)
            return
        stated = read_about(about or ())
        sources: list[MarkSource] = [LineMarks()] if marks else []
        if marks_from is not None:
            sources.append(LslMarks(marks_from))
        recorder = TelemetryRecorder(address, file, keys, stated, sources, recorder_name)
    stop_on_signals(recorder.stop)
    if not recorder.run(seconds, until_silent, display_pid):
        raise SystemExit(NOT_WHOLE)


def _publish_to_lsl(
    address: str, keys: ClientKeys | None, seconds: float | None, until_silent: float | None
) -> None:
    # Imported here: it needs a library that a recording does without.
    from telepulse.lsl_outlet import LslOutlet

    outlet = LslOutlet(address, keys)
    stop_on_signals(outlet.stop)
    if not outlet.run(seconds, until_silent):
        raise SystemExit(NOT_WHOLE)


def mark(
    address: AddressArgument,
    text: Annotated[str, typer.Argument(help="Text of the mark; without one it is numbered.")] = "",
    key: KeyOption = None,
    peer: PeerOption = None,
    insecure: InsecureOption = False,
) -> None:
    """Mark the present time of a display: in its recording, on its page and in its terminal.

    Prints the mark as the display has published it. The text does not go to the sensing node.

    --key is the display's own key file. With another key, give the display's public key as --peer.

    Exit status: 0 when the display has published the mark, 1 when it did not within 5 s, 2 when
    the command cannot begin.
    """
    from telepulse.telemetry.client import await_mark

    with one_line_errors(PROGRAM):
        configure_logging()
        keys = KeyOptions(key, peer, insecure=insecure).telemetry_client(address)
        published = await_mark(address, keys, text, MARKED_WITHIN_S)
    if published is None:
        logger.error(f"{address}: no mark, the display did not answer within {MARKED_WITHIN_S:g} s")
        raise SystemExit(NOT_WHOLE)
    plain_console().print(f"mark: {published.text}")


def replay(
    file: FileArgument,
    bind: Annotated[str, typer.Option(help="Address to stream from, as a sensing node does.")] = (
        "tcp://127.0.0.1:5555"
    ),
    seconds: StopAfterOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    log_level: LogLevelOption = None,
    key: KeyOption = None,
    allow: AllowOption = None,
    insecure: InsecureOption = False,
    press: Annotated[
        bool,
        typer.Option(
            "--press",
            help="Let a finger press a recorded sweep anew: the pulse follows its hold-down.",
        ),
    ] = False,
) -> None:
    """Play a recording as a sensing node would: the same samples at the same intervals.

    The stream's name, rate, elastic layer and frames are the recorded ones; samples that the
    recording lacks count as lost. Of several sessions, the longest is played. Displays connect
    as to a sensing node; --allow limits them.

    With --press, a recording of a sweep (`telepulse sweep --record`) becomes a wrist: its beats are
    played again and again, with height and shape of the hold-down that a display's finger sets.
    FILE may then also be its table samples.csv or .parquet, as `telepulse export` writes it.

    Exit status: 0 at the end of the recording, 2 when the recording cannot be read or the
    address cannot be used; the reason is one line on stderr.
    """
    from sensing_node.feeds import ReplayFeed, SourceOrFeed
    from sensing_node.node import SensingNode
    from telepulse.recording.recorded_wrist import RecordedWrist, exported_session
    from telepulse.recording.session import longest_session

    console = plain_console(quiet, json)
    with one_line_errors(PROGRAM):
        configure_logging(log_level, quiet)
        raise_file_limit()
        check_writable(json)
        keys = KeyOptions(key, allow=allow, insecure=insecure).server(bind)
        exported = press and file.suffix in (".csv", ".parquet")
        session = exported_session(file) if exported else longest_session(file)
        description = session.description
        source: SourceOrFeed = ReplayFeed(description, session.frames())
        if press:
            source = RecordedWrist(session)
            description = replace(description, channels=source.channels)
        node = SensingNode(source, description, bind, keys=keys)
        provenance = collect()
    stop_on_signals(node.stop)
    length_s = session.samples * description.period_ns * 1e-9
    logger.info(f"playing {description.name!r} of {file} on {bind}: {length_s:.1f} s")
    freeze_objects()
    summary = node.run(seconds)
    sum_up(PROGRAM, summary, "replay", console, json, provenance)


def export(
    file: FileArgument,
    to: Annotated[
        Literal["csv", "parquet", "edf", "wfdb", "xdf", "mcap"],
        typer.Option(
            help="csv, parquet: tables of samples, ticks, clock, events and beats; edf, wfdb, xdf:"
            " forces as signals; mcap: a repaired file."
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH", help="A folder for tables, otherwise a file; it must not exist yet."
        ),
    ] = None,
    log_level: LogLevelOption = None,
) -> None:
    """Write a recording as tables or signals, or repair one that was cut short.

    csv, parquet: samples, ticks, clock, events and beats in a new folder. edf, wfdb, xdf: wrist
    forces and felt forces of the longest session; in EDF+ and XDF with events and losses as
    annotations. mcap: the readable part of a recording whose recorder was killed, with the index
    that Foxglove needs.
    """
    from telepulse.recording.export import export_csv, export_mcap, export_parquet
    from telepulse.recording.signal_export import export_signals

    ways: dict[str, tuple[Callable[[Path, Path], str], str]] = {
        "csv": (export_csv, ""),
        "parquet": (export_parquet, ".parquet"),
        "edf": (export_signals, ".edf"),
        "wfdb": (partial(export_signals, suffix=".hea"), ".hea"),
        "xdf": (partial(export_signals, suffix=".xdf"), ".xdf"),
        "mcap": (export_mcap, ".whole.mcap"),
    }
    export_to, suffix = ways[to]
    with one_line_errors(PROGRAM):
        configure_logging(log_level)
        plain_console().print(export_to(file, out or file.with_suffix(suffix)))


def report(
    file: FileArgument,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Write the report here; default: beside the file."),
    ] = None,
    json: TablesOption = None,
) -> None:
    """Write a report of a recording: figures, forces, delays, loss, clocks, loop, heart rate.

    Writes a page with plots, by default to the folder FILE-report, and prints its tables. The
    figures of the recorded span are computed from the messages, and shown beside those that the
    display counted over its whole run, which may have begun earlier.
    """
    from telepulse.recording.report import build_recording_report

    folder = out or file.with_name(f"{file.stem}-report")
    publish(lambda: build_recording_report(file), folder, json)


if __name__ == "__main__":
    typer.run(unblocked_output()(record))
