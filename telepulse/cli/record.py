"""`telepulse record`; `display-node --record` runs this module as its recorder."""

from pathlib import Path
from typing import Annotated

import typer

from protocol.cli_options import (
    InsecureOption,
    KeyOption,
    LogLevelOption,
    PeerOption,
    QuietOption,
    StopAfterOption,
    one_line_errors,
    telemetry_keys,
)
from protocol.host.output import configure_logging, unblocked_output
from protocol.host.process import stop_on_signals
from telepulse.cli.options import NOT_WHOLE, PROGRAM, AddressArgument, SilenceOption


def record(
    address: AddressArgument,
    file: Annotated[Path, typer.Argument(metavar="FILE.mcap", help="It must not be there yet.")],
    seconds: StopAfterOption = None,
    until_silent: SilenceOption = None,
    quiet: QuietOption = False,
    log_level: LogLevelOption = None,
    key: KeyOption = None,
    peer: PeerOption = None,
    insecure: InsecureOption = False,
    display_pid: Annotated[int | None, typer.Option(hidden=True)] = None,
) -> None:
    """Record all that a display receives and does into an MCAP file, which Foxglove opens.

    Every frame as it came, every tick, the statuses, the stream's description, clock replies and
    events. Ends with the display. Killed, it loses at most its last second; on a full disk it waits
    for space. `display-node --record FILE` starts this beside the display.

    With --key alone, the key is the display's own.

    Exit status: 0 when all was written, 1 when something is missing, which it prints, 2 when it
    cannot begin.
    """
    from telepulse.recording.recorder import McapRecorder

    with one_line_errors(PROGRAM):
        configure_logging(log_level, quiet)
        keys = telemetry_keys(address, key, peer, insecure)
        recorder = McapRecorder(address, file, keys)
    stop_on_signals(recorder.stop)
    if not recorder.run(seconds, until_silent, display_pid):
        raise SystemExit(NOT_WHOLE)


if __name__ == "__main__":
    typer.run(unblocked_output()(record))
