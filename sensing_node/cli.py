"""Command line of the sensing node."""

import logging
from contextlib import ExitStack
from typing import Annotated

import typer

from protocol import cli_options as options
from protocol.config.scene_file import find_scene, scene_names
from protocol.discovery.announcer import start_announcer
from protocol.host.output import check_writable, configure_logging, unblocked_output
from protocol.host.process import (
    freeze_objects,
    raise_file_limit,
    request_short_slices,
    stop_on_signals,
)
from protocol.host.realtime import check_strict, parse_realtime
from protocol.provenance import collect
from protocol.security.link_keys import KeyOptions
from protocol.sockets import control_address
from sensing_node.node import SensingNode
from sensing_node.scene import describe_stream, load_sensing, log_repetition, open_source

logger = logging.getLogger(__name__)

PROGRAM = "sensing-node"
TELEMETRY = "tcp://127.0.0.1:*"
app = typer.Typer(rich_markup_mode="markdown")


@app.command()
def sense(
    scene: Annotated[
        str,
        typer.Argument(
            help="Scene file, or the name of one; its [sensing] section is used.",
            autocompletion=scene_names,
        ),
    ],
    bind: Annotated[
        str,
        typer.Option(
            help="Address to stream from: tcp://*:5555 for all interfaces, tcp://127.0.0.1:5555"
            " for this machine alone, or ipc://PATH. Control uses the next port."
        ),
    ] = "tcp://127.0.0.1:5555",
    source: options.SourceOption = None,
    channel: options.RecordChannelOption = None,
    rate: options.RecordRateOption = None,
    preload: options.RecordPreloadOption = None,
    seconds: options.StopAfterOption = None,
    json: options.JsonOption = None,
    quiet: options.QuietOption = False,
    log_level: options.LogLevelOption = None,
    key: options.KeyOption = None,
    allow: options.AllowOption = None,
    insecure: options.InsecureOption = False,
    realtime: options.RealtimeOption = None,
    metrics: options.MetricsOption = None,
    announce: options.AnnounceOption = False,
    version: options.VersionOption = False,
) -> None:
    """Stream the pulse of a source to every display that requests it.

    The scene's **[sensing]** section names the source (synthetic, a recording, or a live sensor
    on a serial port, a CAN bus or LSL), the batch of samples in a frame, and the rubber layer at
    the wrist. Frames are published over ZeroMQ even without a display; displays may join, leave
    and come back at any time.

    On the machine at the wrist, once `telepulse keys` has made the keys:

        sensing-node radial --bind "tcp://*:5555" --key keys/wrist.key

    On the machine at the finger:

        display-node radial --connect tcp://HOST:5555 \\
            --key keys/finger.key --peer keys/wrist.pub

    Open ports 5555 (data) and 5556 (control). Ctrl-C or SIGTERM ends the stream cleanly: every
    display receives the number of samples sent, so that every sample is accounted for.

    Exit status: 0 at the end of the stream, 2 when the scene, the source, the probe's drive or
    the address cannot be used, 3 when a probe ended at a fault; the reason is on stderr.
    """
    console = options.plain_console(quiet, json)
    with ExitStack() as until_the_end:
        with options.one_line_errors(PROGRAM):
            configure_logging(log_level, quiet)
            raise_file_limit()
            request_short_slices()
            check_writable(json)
            request = parse_realtime(realtime)
            check_strict(request)
            control = control_address(bind)
            keys = KeyOptions(key, allow=allow, insecure=insecure).server(bind)
            path = find_scene(scene)
            record = {"source": None if source is None else str(source), "channel": channel}
            section = load_sensing(path, record | {"rate": rate, "preload": preload})
            provenance = collect(path, {"sensing": section})
            served = until_the_end.enter_context(options.start_metrics(PROGRAM, metrics))
            announce_node = until_the_end.enter_context(
                start_announcer(announce, bind, section.stream, keys)
            )
            opened = until_the_end.enter_context(open_source(section, path.parent))
            description = describe_stream(section, opened)
            node = SensingNode(
                *(opened, description, bind),
                keys=keys,
                telemetry_address=TELEMETRY if served else None,
            )
            if served is not None:
                served.send(address=node.telemetry_address, key=None)
            announce_node()
        stop_on_signals(node.stop)
        logger.info(
            f"streaming {description.name!r}: {description.rate_hz:g} Hz in frames of"
            f" {description.batch} on {bind} (control {control})"
        )
        log_repetition(opened, seconds)
        if description.group_delay_ns:
            delay_ms = description.group_delay_ns * 1e-6
            logger.info(f"the conditioning chain delays the pulse by {delay_ms:.1f} ms")
        freeze_objects()
        with options.apply_and_log_realtime(PROGRAM, request) as grant:
            summary = options.with_realtime_settings(node.run(seconds), grant)
    options.sum_up(PROGRAM, summary, "sensing node", console, json, provenance)
    raise SystemExit(options.fault_status(PROGRAM, summary))


def main() -> None:
    """Entry point of `sensing-node`."""
    configure_logging()
    with unblocked_output():
        app()


if __name__ == "__main__":
    main()
