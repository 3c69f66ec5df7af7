"""`telepulse record`, `replay` and `export`."""

import sys
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from protocol.commands import (
    JsonOption,
    QuietOption,
    StopAfterOption,
    one_line_errors,
    plain_console,
    sum_up,
)
from protocol.keys import ClientKeys, read_pair
from protocol.protection import (
    AllowOption,
    InsecureOption,
    KeyOption,
    PeerOption,
    client_keys,
    server_keys,
)
from protocol.signals import stop_on_signals
from protocol.summary import check_writable

PROGRAM = "telepulse"
NOT_WHOLE = 1

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="A recording.")]


def record(
    address: Annotated[str, typer.Argument(help="A display's telemetry: tcp://HOST:PORT.")],
    file: Annotated[Path, typer.Argument(metavar="FILE.mcap", help="It must not be there yet.")],
    seconds: StopAfterOption = None,
    until_silent: Annotated[
        float | None,
        typer.Option(min=0.1, metavar="SECONDS", help="End too when nothing came for so long."),
    ] = None,
    quiet: QuietOption = False,
    key: KeyOption = None,
    peer: PeerOption = None,
    insecure: InsecureOption = False,
) -> None:
    """Record all that a display hears and does into an MCAP file, which Foxglove opens.

    Every frame as it came, every tick, the statuses, the stream's description, clock replies and
    what happened. Ends with the display. Killed, it loses at most its last second; a full disk is
    waited for. `display-node --record FILE` starts this beside the display.

    With --key alone, the key is the display's own.

    Exit status: 0 when all was written, 1 when something is missing, which is said, 2 when it
    cannot begin.
    """
    from telepulse.record.recorder import Recorder

    console = plain_console(quiet)
    with one_line_errors(PROGRAM):
        if key is not None and peer is None:
            pair = read_pair(key)
            keys: ClientKeys | None = ClientKeys(pair, pair.public)
        else:
            keys = client_keys([address], key, peer, insecure)
        recorder = Recorder(address, file, console.print, _warn, keys)
    stop_on_signals(recorder.stop)
    if not recorder.run(seconds, until_silent):
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
    from sensing_node.sources.replay import Replay
    from telepulse.record.session import longest_session

    console = plain_console(quiet)
    with one_line_errors(PROGRAM):
        check_writable(json)
        keys = server_keys(bind, key, allow, insecure)
        session = longest_session(file, console.print)
        description = session.description
        source = Replay(description, session.frames())
        node = SensingNode(source, description, bind, log=console.print, keys=keys)
    stop_on_signals(node.stop)
    length_s = session.samples * description.period_ns * 1e-9
    console.print(f"playing {description.name!r} of {file} on {bind}: {length_s:.1f} s")
    sum_up(PROGRAM, node.run(seconds), "replay", console, json)


class Kind(Enum):
    """What a recording is exported to."""

    CSV = "csv"
    MCAP = "mcap"


def export(
    file: FileArgument,
    to: Annotated[Kind, typer.Option(help="csv: a table a topic; mcap: a whole file again.")],
    out: Annotated[
        Path | None, typer.Option(metavar="PATH", help="A folder for csv, else a file; not there.")
    ] = None,
) -> None:
    """Write a recording as tables, or one that was cut short as a whole file.

    csv: samples.csv, ticks.csv, clock.csv and events.csv in a new folder. mcap: what can be read
    of a recording whose recorder was killed, with the index that Foxglove needs.
    """
    from telepulse.record.export import export_csv, export_mcap

    console = plain_console()
    with one_line_errors(PROGRAM):
        if to is Kind.CSV:
            export_csv(file, out or file.with_suffix(""), console.print)
        else:
            export_mcap(file, out or file.with_suffix(".whole.mcap"), console.print)


def _warn(text: str) -> None:
    with suppress(OSError):  # who listens may have gone before the recorder
        print(f"{PROGRAM}: {text}", file=sys.stderr)
