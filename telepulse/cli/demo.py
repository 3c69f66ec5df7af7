"""`telepulse demo`: both nodes as real processes on this machine, with a summary at the end.

On one machine both ends can be measured: the demo subscribes to the sensing node and to the
display's telemetry, and scores the felt force against the sensed one.
"""

import logging
import tempfile
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from subprocess import PIPE
from typing import Annotated

import typer
import zmq
from rich.console import Console

from display_node.fault_advice import FAULT_STATUS, SENSING_NOTE, end_at_faults
from display_node.scoring.tracking_error import TrackingError
from display_node.telemetry.terminal import watch
from protocol import sockets
from protocol.cli_options import (
    DurationOption,
    JsonOption,
    LogLevelOption,
    one_line_errors,
    plain_console,
    sum_up,
)
from protocol.config.scene_file import find_scene
from protocol.errors import OutputError, TelepulseError
from protocol.host.child_process import ChildProcess
from protocol.host.output import check_writable, configure_logging
from protocol.host.process import stop_on_signals
from protocol.run_summary import Summary
from protocol.tactile import matching_force_ratio
from protocol.wire.messages import decode_frame
from protocol.wire.telemetry import Trace
from sensing_node.scene import open_source
from telepulse.cli.options import PROGRAM, LinkOption, SceneArgument
from telepulse.cli.view import MISSING, bokeh_is_there
from telepulse.processes import NodeProcess, free_addresses
from telepulse.scene import DEFAULT_SCENE, Scene, load_scene, scene_provenance
from telepulse.simulation.link_model import LinkScene, parse_link
from telepulse.simulation.reference_force import ReferenceForce

logger = logging.getLogger(__name__)

STARTS_WITHIN_S = 30.0
ENDS_WITHIN_S = 10.0
# The display is listening before the pulse begins.
HEAD_START_S = 0.7


class DemoError(TelepulseError, RuntimeError):
    """The two nodes' sample counts differ."""


def demo(
    scene: SceneArgument = DEFAULT_SCENE,
    seconds: DurationOption = 15.0,
    link: LinkOption = None,
    json: JsonOption = None,
    ui: Annotated[
        bool, typer.Option(help="Show the live state: a panel, or a line a second.")
    ] = True,
    page: Annotated[
        bool | None,
        typer.Option(
            "--page/--no-page",
            help="Serve the live page for a browser, whose address is the first line; as --ui"
            " unless given.",
            show_default=False,
        ),
    ] = None,
    log_level: LogLevelOption = None,
) -> None:
    """Run both nodes on this machine over TCP, watch them live, and sum up.

    A sensing node and a display node start as two processes. With --link, a third stands
    between them and delays, jitters and loses frames. At the end, every sample sent is
    accounted for: sent = played + late + lost.

    Exit status: 0 at the end of the pulse, 2 when an argument cannot be used, 3 when the display
    latched a fault; the reason is a line on stderr.
    """
    console = plain_console()
    with one_line_errors(PROGRAM):
        configure_logging(log_level)
        check_writable(json)
        path = find_scene(scene)
        loaded = load_scene(path)
        if link:
            loaded = replace(loaded, link=parse_link(link))
        provenance = scene_provenance(loaded)
        summary = run_demo(loaded, seconds, ui, page, console)
    sum_up(PROGRAM, summary, f"demo of {path.stem}, {seconds:g} s", console, json, provenance)
    end_at_faults(PROGRAM, summary.faults)


def run_demo(
    scene: Scene, seconds: float, draw: bool, page: bool | None, console: Console
) -> Summary:
    """Run both nodes for `seconds` of pulse, over the scene's link.

    page: serve the live page too; None: where it can be, with `draw`. Raises SceneError,
    SourceError, ProcessError, DemoError, or OutputError where the page is required and cannot be.
    """
    path, link = scene.path, scene.link
    truth = ReferenceForce(scene.sensing, scene.path.parent)
    # The display, which may move a drive, is started before the sensing node.
    with open_source(scene.sensing, scene.path.parent):
        pass
    impaired = link != LinkScene()
    sensing_address, link_address, telemetry_address = free_addresses(3)
    display_address = link_address if impaired else sensing_address
    with tempfile.TemporaryDirectory(prefix="telepulse-") as folder, ExitStack() as stack:
        # Before anything else, so that the page shows the beginning.
        served = None
        if page or (page is None and draw):
            served = _open_page(stack, telemetry_address, bool(page), console)
        display = NodeProcess(
            *("display node", "display_node.cli", str(path), "--connect", display_address),
            *("--telemetry", telemetry_address, "--once", "--quiet"),
            *("--seconds", str(seconds + ENDS_WITHIN_S)),
            summary=Path(folder, "display.json"),
            stdout=PIPE,
            stderr=PIPE,
        )
        stack.callback(display.stop)
        relay = None
        if impaired:
            relay = ChildProcess(
                *("link between the nodes", "-m", "telepulse", "link"),
                *("--connect", sensing_address, "--bind", display_address),
                *("--link", link.text(), "--seconds", str(seconds + ENDS_WITHIN_S)),
                stdout=PIPE,
                stderr=PIPE,
            )
            stack.callback(relay.stop)
        time.sleep(HEAD_START_S)
        sensing = NodeProcess(
            *("sensing node", "sensing_node.cli", str(path), "--bind", sensing_address),
            *("--seconds", str(seconds), "--quiet"),
            summary=Path(folder, "sensing.json"),
            stdout=PIPE,
            stderr=PIPE,
        )
        stack.callback(sensing.stop)
        # Ctrl-C ends the pulse; what was sent of it is played and summed up all the same.
        stop_on_signals(sensing.terminate)
        with _Scorer(scene, truth, sensing_address) as scorer:

            def meanwhile() -> bool:
                scorer.listen()
                return display.poll() is None and not sensing.poll()

            watch(telemetry_address, console, scorer.felt, draw, meanwhile)
        if served is not None and served.poll() is not None:
            logger.warning("the live page ended before the demo did")
        if relay is not None and relay.poll():
            relay.await_end(ENDS_WITHIN_S)
        sensed = sensing.await_summary(ENDS_WITHIN_S)
        played = display.await_summary(ENDS_WITHIN_S, may_end_with=FAULT_STATUS)
        return _compose(sensed, played, scorer.fidelity)


def _open_page(
    stack: ExitStack, telemetry: str, required: bool, console: Console
) -> ChildProcess | None:
    """Start the live page until `stack` closes; print its address, or why there is none.

    required: raise OutputError or ProcessError instead.
    """
    try:
        if not bokeh_is_there():
            raise OutputError(MISSING)
        page = ChildProcess(
            *("live page", "-m", "telepulse", "view", telemetry), stdout=PIPE, stderr=PIPE
        )
        stack.callback(page.stop)
        console.print(page.read_line(STARTS_WITHIN_S))
    except TelepulseError as error:
        if required:
            raise
        logger.warning(f"no live page: {error}")
        return None
    return page


class _Scorer:
    """Compares the pulse that the sensing node sends with the force that the display reports."""

    def __init__(self, scene: Scene, truth: ReferenceForce, sensing_address: str) -> None:
        layer = scene.display.layer.layer()
        self._channel = scene.display.channel
        self._truth = truth
        self._ratio = matching_force_ratio(scene.sensing.layer.layer(), layer)
        self._context: sockets.Context = zmq.Context()
        self._data = sockets.connect(self._context, zmq.SUB, sensing_address)
        self._data.subscribe(b"")
        self.fidelity = TrackingError(layer.strain_per_newton)

    def __enter__(self) -> "_Scorer":
        return self

    def __exit__(self, *_: object) -> None:
        self.listen()
        self.fidelity.finish()
        self._context.destroy(linger=0)

    def listen(self) -> None:
        """Add the frames that the sensing node has sent."""
        for (message,) in sockets.receive_all(self._data):
            true_frame = self._truth.of(decode_frame(message))
            self.fidelity.add_reference(true_frame, self._channel, self._ratio)

    def felt(self, trace: Trace) -> None:
        """Add the felt force of a trace of the display."""
        for now_ns, instant_ns, force_n, scored in zip(
            *(column.tolist() for column in (trace.now_ns, trace.instant_ns, trace.felt_n)),
            trace.scored.tolist(),
            strict=True,
        ):
            if scored:
                self.fidelity.add_output(now_ns, instant_ns, force_n)


def _compose(sensing: Summary, display: Summary, fidelity: TrackingError) -> Summary:
    """Return the display's summary with the true errors.

    Raises DemoError where the two nodes' sample counts differ.
    """
    sent = sensing.samples.sent
    if display.clock.offset_ms is None:
        raise DemoError("the display received nothing from the sensing node")
    accounted = (display.samples.sent or 0) + (display.samples.before_joining or 0)
    if sent != accounted:
        raise DemoError(
            f"the sensing node sent {sent} samples, the display accounts for {accounted}"
        )
    causes = {*display.rejected, *sensing.rejected}
    return replace(
        fidelity.scored(display),
        rejected={c: display.rejected.get(c, 0) + sensing.rejected.get(c, 0) for c in causes},
        limited=replace(display.limited, adc=sensing.limited.adc),
        faults=display.faults + [f"{SENSING_NOTE}{note}" for note in sensing.faults],
    )
