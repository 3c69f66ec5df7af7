"""Command line of the display node."""

import logging
import subprocess
from contextlib import closing, suppress
from pathlib import Path
from typing import Annotated

import typer

from display_node.benches import open_press, start_benches
from display_node.doctor import run_doctor
from display_node.node import DisplayNode
from display_node.reception.addresses import discovered, list_nodes
from display_node.scene import DisplayScene
from display_node.telemetry.recorder_process import is_whole, start_recorder
from display_node.verdict import NOT_VALID_STATUS, conclude
from protocol import cli_options as options
from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene, scene_names
from protocol.errors import DiscoveryError, OutputError, SceneError
from protocol.host.child_process import ChildProcess
from protocol.host.output import check_writable, configure_logging, unblocked_output
from protocol.host.process import (
    freeze_objects,
    interrupt_on_signals,
    raise_file_limit,
    request_short_slices,
    stop_on_signals,
)
from protocol.host.realtime import RealtimeRequest, check_strict, parse_realtime
from protocol.provenance import collect
from protocol.security.link_keys import KeyOptions
from protocol.summary.fields import Summary

logger = logging.getLogger(__name__)

PROGRAM = "display-node"
SCREEN_ENDS_WITHIN_S = 5
NOT_WHOLE = 1
HERE = "tcp://127.0.0.1:5555"
app = typer.Typer(rich_markup_mode="markdown")


@app.command()
def display(
    scene: Annotated[
        str | None,
        typer.Argument(
            help="Scene file, or the name of one; its [display] section is used.",
            show_default=False,
            autocompletion=scene_names,
        ),
    ] = None,
    connect: Annotated[
        list[str],
        typer.Option(
            help="Address of the sensing node: tcp://HOST:5555 or ipc://PATH. The node may start"
            " later. Repeat the option with one address for each network path: the first copy of"
            " each frame is used, and the stream continues while any path is up."
        ),
    ] = [HERE],  # noqa: B006
    discover: options.DiscoverOption = False,
    named: options.NamedOption = None,
    predictor: options.PredictorOption = None,
    compensation: options.CompensationOption = None,
    seconds: options.StopAfterOption = None,
    once: Annotated[
        bool, typer.Option("--once", help="Stop when the stream has ended and was played.")
    ] = False,
    json: options.JsonOption = None,
    details: options.DetailsOption = False,
    telemetry: Annotated[
        str, typer.Option(help="Address to publish telemetry on; * picks a free port.")
    ] = "tcp://127.0.0.1:*",
    screen: Annotated[
        bool,
        typer.Option(
            help="Show the live state: a line that is renewed in a terminal, or one a second."
        ),
    ] = True,
    record: Annotated[
        Path | None,
        typer.Option(metavar="FILE.mcap", help="Record all of this run: see telepulse record."),
    ] = None,
    about: options.AboutOption = None,
    quiet: options.QuietOption = False,
    log_level: options.LogLevelOption = None,
    key: options.KeyOption = None,
    peer: options.PeerOption = None,
    allow: options.AllowOption = None,
    insecure: options.InsecureOption = False,
    realtime: options.RealtimeOption = None,
    metrics: options.MetricsOption = None,
    without_film: Annotated[
        bool,
        typer.Option(
            "--without-film",
            help="Allow a drive to press although no film measures the force at the finger.",
        ),
    ] = False,
    doctor: Annotated[
        bool,
        typer.Option(
            "--doctor",
            help="Play nothing: print the real-time measures that this host grants, and how late"
            " ticks are with and without them. SCENE may be left out.",
        ),
    ] = False,
    version: options.VersionOption = False,
) -> None:
    """Feel a remote pulse: play a sensing node's stream on the local actuator.

    The scene's **[display]** section names the perceived delay (`compensation`), the
    controller, the actuator, the rubber layer under the finger and the safety limits. The
    properties of the wrist's layer come with the stream; the force is chosen so that both strains
    are equal.

    The sensing node may start later, stop and start again: the display waits without a
    target force, and ramps up when the stream arrives.

        display-node radial --connect tcp://HOST:5555 \\
            --key keys/finger.key --peer keys/wrist.pub

    `telepulse keys` makes the keys. Telemetry that leaves this machine is protected by this
    node's own key; `--allow` names the allow-list of its readers, a file like the sensing node's.

    `--discover` finds a sensing node that announces itself. Without a scene it plays nothing, and
    lists all of them, for 4 s or `--seconds`. Announcements are not authenticated: only its key
    proves which node it is (`--peer`).

    The real-time loop is alone in this process. The live state is drawn by a second process
    from the telemetry, which other programs may read as well (`--telemetry`). If ticks are late,
    `--doctor` prints the settings that help on this host, and `--realtime` requests them.

    Exit status: 0 when stopped or at the stream's end (`--once`); 1 when the recording is
    incomplete (`--record`); 2 when the scene, an address or a file cannot be used; 3 when a fault
    was latched before the end; 4 when a run of `--seconds` or `--once` is not valid: nothing was
    felt, or more than half of the ticks were missed. The reason is a line on stderr, or the first
    one of the summary. A latched fault does not end the program: the tip is withdrawn, and the
    fault is shown with advice until the program is stopped.
    """
    console = options.plain_console(quiet, json)
    with options.one_line_errors(PROGRAM):
        configure_logging(log_level, quiet)
        raise_file_limit()
        request_short_slices()
        check_writable(json)
        if doctor:
            run_doctor(None if scene is None else find_scene(scene), seconds, console, json)
            return
        if scene is None and discover:
            list_nodes(seconds, console, json)
            return
        if scene is None:
            raise SceneError("no scene: display-node SCENE plays one")
        request = parse_realtime(realtime)
        check_strict(request)
        key_options = KeyOptions(key, peer, allow, insecure)
        if discover or named is not None:
            if connect != [HERE]:
                raise DiscoveryError(
                    "--discover finds the address, and --connect is given: choose one"
                )
            connect = discovered(named, key_options.peer_key if peer else None, seconds)
        client_keys = key_options.client(*connect)
        telemetry_keys = key_options.telemetry_server(telemetry)
        path = find_scene(scene)
        choice = {"predictor": predictor, "compensation": compensation}
        section = load_section(path, "display", DisplayScene, choice)
        # Screen, recorder and metrics server read protected telemetry with the display's own key.
        reader_key_path = key if telemetry_keys else None
        provenance = collect(path, {"display": section})
        # A signal raises KeyboardInterrupt, so that a drive on its way home is brought to rest.
        interrupt_on_signals()
        if about and record is None:
            raise OutputError("--about states something of a recording: add --record FILE.mcap")
        recorder_options = [f"--about={each}" for each in about or ()]
        recorder_options += [] if log_level is None else ["--log-level", log_level]
        recorder_options += ["--quiet"] if quiet else []
        with (
            options.start_metrics(PROGRAM, metrics) as served,
            closing(
                DisplayNode(
                    section,
                    connect,
                    telemetry,
                    client_keys,
                    telemetry_keys,
                    provenance.to_bytes(),
                )
            ) as node,
            start_recorder(node.telemetry, record, reader_key_path, recorder_options) as recorder,
        ):
            freeze_objects()
            # Last, so that everything else that can fail does so before the drive moves.
            with (
                open_press(section, path.parent) as press,
                start_benches(section, path.parent, without_film) as benches,
            ):
                if press is not None:
                    node.use_press(press)
                if served is not None:
                    served.send(
                        address=node.telemetry_address, key=reader_key_path and str(reader_key_path)
                    )
                node.use(*benches)
                draw = screen and not quiet
                summary = _run(node, connect, seconds, once, draw, reader_key_path, request)
    status = conclude(PROGRAM, summary, "display node", console, json, provenance, details)
    if status == NOT_VALID_STATUS and node.stopped:
        status = 0
    if status != options.FAULT_STATUS and not is_whole(recorder, summary):
        status = NOT_WHOLE
    raise SystemExit(status)


def _run(
    node: DisplayNode,
    connect: list[str],
    seconds: float | None,
    once: bool,
    screen: bool,
    reader_key_path: Path | None,
    request: RealtimeRequest,
) -> Summary:
    """Run the node, and a process that draws its state.

    reader_key_path: key with which that process reads the telemetry; None where it needs none.
    """
    stop_on_signals(node.stop)
    logger.info(f"waiting for {', '.join(connect)}; telemetry on {node.telemetry_address}")
    watcher = None
    if screen:
        arguments = [node.telemetry_address, *([str(reader_key_path)] if reader_key_path else [])]
        watcher = ChildProcess(
            "screen", "-m", "display_node.telemetry.terminal", *arguments, own_session=False
        )
    # Applied last, because processes started later would inherit some of the settings.
    with options.apply_and_log_realtime(PROGRAM, request) as grant:
        summary = options.with_realtime_settings(node.run(seconds, once), grant)
    if watcher is not None:
        with watcher, suppress(subprocess.TimeoutExpired):
            watcher.wait(SCREEN_ENDS_WITHIN_S)
    return summary


def main() -> None:
    """Entry point of `display-node`."""
    configure_logging()
    with unblocked_output():
        app()


if __name__ == "__main__":
    main()
