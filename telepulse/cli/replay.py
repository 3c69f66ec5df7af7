"""`telepulse replay`."""

import logging
from typing import Annotated

import typer

from protocol.cli_options import (
    AllowOption,
    InsecureOption,
    JsonOption,
    KeyOption,
    LogLevelOption,
    QuietOption,
    StopAfterOption,
    one_line_errors,
    plain_console,
    server_keys,
    sum_up,
)
from protocol.host.output import check_writable, configure_logging
from protocol.host.process import allow_connections, freeze_objects, stop_on_signals
from protocol.provenance import collect
from telepulse.cli.options import PROGRAM, FileArgument

logger = logging.getLogger(__name__)


def replay(
    file: FileArgument,
    bind: Annotated[str, typer.Option(help="Address to stream from, as of a sensing node.")] = (
        "tcp://127.0.0.1:5555"
    ),
    seconds: StopAfterOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    log_level: LogLevelOption = None,
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
    from sensing_node.feeds import ReplaySource
    from sensing_node.node import SensingNode
    from telepulse.recording.session import longest_session

    console = plain_console(quiet)
    with one_line_errors(PROGRAM):
        configure_logging(log_level, quiet)
        allow_connections()
        check_writable(json)
        keys = server_keys(bind, key, allow, insecure)
        session = longest_session(file)
        description = session.description
        source = ReplaySource(description, session.frames())
        node = SensingNode(source, description, bind, keys=keys)
        provenance = collect()
    stop_on_signals(node.stop)
    length_s = session.samples * description.period_ns * 1e-9
    logger.info(f"playing {description.name!r} of {file} on {bind}: {length_s:.1f} s")
    freeze_objects()
    summary = node.run(seconds)
    sum_up(PROGRAM, summary, "replay", console, json, provenance)
