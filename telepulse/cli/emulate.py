"""`telepulse emulate`: one command a piece of hardware."""

import threading
import time
from contextlib import closing
from pathlib import Path
from typing import Annotated, Literal

import typer

from protocol.cli_options import LogLevelOption, StopAfterOption, one_line_errors, plain_console
from protocol.config.quantities import count_text
from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene
from protocol.host.output import configure_logging
from protocol.host.process import freeze_objects, stop_on_signals
from pulse_sensors.binary_frames import MAX_SAMPLES, SampleFormat
from telepulse.cli import emulate_drives as drive_commands
from telepulse.cli.options import PROGRAM
from telepulse.scene import DEFAULT_SCENE

FOREVER_S = 1e9
app = typer.Typer(no_args_is_help=True, help="Hardware that is not there, speaking its real bytes.")
app.command()(drive_commands.tmcl)
app.command()(drive_commands.cia402)

LinkOption = Annotated[
    Path | None,
    typer.Option(metavar="PATH", help="Make this link to the port, for a scene to name."),
]


@app.command()
def sensor(
    scene: Annotated[str, typer.Argument(help="Its source is what the board senses.")] = (
        DEFAULT_SCENE
    ),
    link: LinkOption = None,
    framing: Annotated[
        Literal["binary", "text", "untimed"],
        typer.Option(help="Frames, lines of time and value, or lines of a value alone."),
    ] = "binary",
    samples: Annotated[
        SampleFormat, typer.Option(help="Of binary frames; integers count 0.1 mN.")
    ] = "float32",
    frame: Annotated[int, typer.Option(min=1, max=MAX_SAMPLES, help="Samples a frame.")] = 4,
    delivery_ms: Annotated[
        float, typer.Option(min=0, max=1000, help="USB delivers after 1/4 of this to all of it.")
    ] = 16.0,
    skew_ppm: Annotated[
        float, typer.Option(min=-10_000, max=10_000, help="By how much its crystal is fast.")
    ] = 50.0,
    noise: Annotated[
        float, typer.Option(min=0, max=1, help="Share of bytes that arrive as another.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="Of deliveries and noise.")] = 1,
    seconds: StopAfterOption = None,
    log_level: LogLevelOption = None,
) -> None:
    """Be a sensor board on a pseudo-terminal that sends a scene's source.

    Prints the table with which a scene reads it. Samples go by the board's own crystal, USB
    delivers them in batches, noise spoils bytes. Stopping it pulls the cable; started again with
    the same --link, it is plugged in again.
    """
    # A board brings the sources' import times; other emulators do without.
    from sensing_node.scene import SensingScene
    from telepulse.emulators.pty_port import PtyPort
    from telepulse.emulators.sensor_board import BoardBehaviour, build_board, play, source_table

    console = plain_console()
    stopped = threading.Event()
    behaviour = BoardBehaviour(
        frame=frame if framing == "binary" else 1,
        skew=skew_ppm * 1e-6,
        begins_us=seed * 1_000_003,
        delivery_ns=round(delivery_ms * 1e6),
        noise=noise,
        seed=seed,
    )
    with one_line_errors(PROGRAM):
        configure_logging(log_level)
        path = find_scene(scene)
        section = load_section(path, "sensing", SensingScene)
        board = build_board(section, path.parent, framing, samples, behaviour)
        port = PtyPort(link)
    stop_on_signals(stopped.set)
    with closing(port):
        console.print(source_table(port.path, board.rate_hz, framing, samples))
        freeze_objects()
        play(board, port, time.monotonic_ns() + round((seconds or FOREVER_S) * 1e9), stopped.is_set)
    console.print(
        f"{count_text(board.sampled, 'sample')} sent,"
        f" {count_text(port.dropped, 'byte')} that nobody read"
    )
