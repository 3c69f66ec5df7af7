"""Command line of the display node."""

import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from display_node.hardware import connected
from display_node.node import DisplayNode
from display_node.scene import DisplayScene
from protocol.commands import (
    InsecureOption,
    JsonOption,
    QuietOption,
    StopAfterOption,
    one_line_errors,
    plain_console,
    sum_up,
    warn_if_open,
)
from protocol.scene import load_section
from protocol.signals import stop_on_signals
from protocol.summary import Summary, check_writable

PROGRAM = "display-node"
SCREEN_ENDS_WITHIN_S = 5
app = typer.Typer(add_completion=False, rich_markup_mode="markdown")


@app.command()
def display(
    scene: Annotated[Path, typer.Argument(help="Scene file; its [display] section is used.")],
    connect: Annotated[
        list[str],
        typer.Option(
            help="Address of the sensing node: tcp://HOST:5555 or ipc://PATH. It need not be"
            " there yet. Give one for each network that leads to it: the first copy of a frame"
            " wins, and while one is cut the others go on."
        ),
    ] = ["tcp://127.0.0.1:5555"],  # noqa: B006
    seconds: StopAfterOption = None,
    once: Annotated[
        bool, typer.Option("--once", help="Stop when the stream has ended and was played.")
    ] = False,
    json: JsonOption = None,
    telemetry: Annotated[
        str, typer.Option(help="Address to publish telemetry on; * picks a free port.")
    ] = "tcp://127.0.0.1:*",
    screen: Annotated[
        bool,
        typer.Option(help="Show the live state: a panel in a terminal, a line a second elsewhere."),
    ] = True,
    quiet: QuietOption = False,
    insecure: InsecureOption = False,
) -> None:
    """Feel a remote pulse: play a sensing node's stream on the local actuator.

    The scene's **[display]** section names the perceived delay (`compensation`), the
    controller, the actuator, the rubber layer under the finger and the safety limits. What the
    wrist's layer is comes with the stream; the force is chosen so that both strains are equal.

    The sensing node may start later, stop and come back: the display waits at rest, joins by
    itself and ramps up.

        display-node scenes/radial.toml --connect tcp://HOST:5555

    The real-time loop is alone in this process. The live state is drawn by a second process
    from the telemetry, which other programs may read as well (`--telemetry`).

    Exit status: 0 when stopped or at the stream's end (`--once`), 2 when the scene or an
    address cannot be used; the reason is one line on stderr.
    """
    console = plain_console(quiet)
    with one_line_errors(PROGRAM):
        check_writable(json)
        section = load_section(scene, "display", DisplayScene)
        with connected(section, scene.parent, console.print) as hardware:
            node = DisplayNode(section, connect, telemetry, console.print, hardware)
            for address in connect:
                warn_if_open(PROGRAM, address, insecure)
            summary = _run(node, connect, seconds, once, screen and not quiet, console)
    sum_up(PROGRAM, summary, "display node", console, json)


def _run(
    node: DisplayNode,
    connect: list[str],
    seconds: float | None,
    once: bool,
    screen: bool,
    console: Console,
) -> Summary:
    """Run the node, beside the process that draws its state."""
    stop_on_signals(node.stop)
    console.print(f"waiting for {', '.join(connect)}; telemetry on {node.telemetry_address}")
    watcher = None
    if screen:
        watcher = subprocess.Popen(
            [sys.executable, "-m", "display_node.screen", node.telemetry_address]
        )
    summary = node.run(seconds, once)
    if watcher is not None:
        try:
            watcher.wait(SCREEN_ENDS_WITHIN_S)
        except subprocess.TimeoutExpired:
            watcher.kill()
    return summary


def main() -> None:
    """Entry point of `display-node`."""
    app()


if __name__ == "__main__":
    main()
