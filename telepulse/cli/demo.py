"""`telepulse demo` and `simulate`: run both nodes, as real processes or in virtual time.

Both ends are on one machine, so the demo can compare them: it subscribes to the sensing node and to
the display's telemetry, and scores the felt force against the sensed one.
"""

import logging
import math
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
import zmq
from rich.console import Console

from display_node.telemetry.terminal import watch
from display_node.verdict import NOT_VALID_STATUS, conclude
from protocol import sockets
from protocol.cli_options import (
    FAULT_STATUS,
    CompensationOption,
    DetailsOption,
    DurationOption,
    JsonOption,
    LogLevelOption,
    PredictorOption,
    RecordChannelOption,
    RecordPreloadOption,
    RecordRateOption,
    SourceOption,
    one_line_errors,
    plain_console,
)
from protocol.errors import ProcessError
from protocol.host.output import check_writable, configure_logging
from protocol.host.process import lower_priority, stop_on_signals
from protocol.summary.fields import PressFigures, Summary, with_sensing_node
from protocol.wire.messages import decode_frame
from protocol.wire.telemetry import Trace
from sensing_node.scene import describe_stream, log_repetition, open_source
from telepulse.cli.options import PROGRAM, LinkOption, SceneArgument, SeedOption, YesOption
from telepulse.cli.progress import SimulationProgress
from telepulse.cli.view import open_page
from telepulse.processes import LoggedNode, LoggedProcess, free_addresses
from telepulse.scene import DEFAULT_SCENE, Scene, load_scene, scene_provenance
from telepulse.simulation.link_scene import LinkScene
from telepulse.simulation.true_errors import TrueErrors
from telepulse.simulation.virtual_time import Simulation

logger = logging.getLogger(__name__)

ENDS_WITHIN_S = 10.0
POLL_NS = 100_000_000


def simulate(
    scene: SceneArgument = DEFAULT_SCENE,
    seconds: DurationOption = 60.0,
    seed: SeedOption = 1,
    source: SourceOption = None,
    channel: RecordChannelOption = None,
    rate: RecordRateOption = None,
    preload: RecordPreloadOption = None,
    link: LinkOption = None,
    predictor: PredictorOption = None,
    compensation: CompensationOption = None,
    json: JsonOption = None,
    details: DetailsOption = False,
    log_level: LogLevelOption = None,
) -> None:
    """Run a scene in virtual time: the nodes' own modules, without sockets and without waiting.

    The same scene and seed give the same figures, several times faster than real time: --details
    prints how many. A terminal shows the progress. Exit status 3: a node latched a fault; it is
    named on stderr. Exit status 4: no pulse was felt.
    """
    with one_line_errors(PROGRAM):
        configure_logging(log_level)
        check_writable(json)
        choice = {"predictor": predictor, "compensation": compensation}
        record = _record(source, channel, rate, preload)
        loaded = _load(scene, link, choice, record)
        provenance = scene_provenance(loaded, {"link": seed})
        simulation = Simulation(loaded, seed)
        log_repetition(simulation.source, seconds)
        with SimulationProgress(seconds) as progress:
            summary = simulation.run(seconds, progress=progress.add)
    title = f"simulation of {source or loaded.path.stem}, {seconds:g} s"
    console = plain_console(json=json)
    raise SystemExit(conclude(PROGRAM, summary, title, console, json, provenance, details))


def demo(
    scene: SceneArgument = DEFAULT_SCENE,
    seconds: DurationOption = 15.0,
    source: SourceOption = None,
    channel: RecordChannelOption = None,
    rate: RecordRateOption = None,
    preload: RecordPreloadOption = None,
    link: LinkOption = None,
    predictor: PredictorOption = None,
    compensation: CompensationOption = None,
    json: JsonOption = None,
    details: DetailsOption = False,
    ui: Annotated[
        bool,
        typer.Option(
            help="Show the live state: a line that is renewed in a terminal, or one a second."
        ),
    ] = True,
    page: Annotated[
        bool | None,
        typer.Option(
            "--page/--no-page",
            help="Serve the live page; its address is printed first. Default: with --ui.",
            show_default=False,
        ),
    ] = None,
    emulated: Annotated[
        bool, typer.Option("--emulated", help="Emulate the boards of a scene such as class_bench.")
    ] = False,
    ports: Annotated[
        tuple[str, str] | None,
        typer.Option(metavar="WRIST FINGER", help="Serial ports of its boards, else found."),
    ] = None,
    yes: YesOption = False,
    log_level: LogLevelOption = None,
) -> None:
    """Run both nodes on this machine over TCP, watch them live, and sum up.

    A sensing node and a display node start as two processes. With an impaired link (--link, or
    the scene's), a third process between them delays and drops frames. At the end, every sample
    sent is accounted for: it was in time, felt ahead by a trusted prediction, late, or lost.

    The boards of a scene such as class_bench are found by their USB ids and by what they send, and
    checked once as by `telepulse bench` before the pulse is played.

    Exit status: 0 at the end of the pulse, 1 when a check of the boards failed, 2 when an argument
    cannot be used, 3 when a node latched a fault, with the reason on stderr, 4 when the run is not
    valid: nothing was felt, or more than half of the ticks were missed.
    """
    console = plain_console(json=json)
    with one_line_errors(PROGRAM), ExitStack() as stack:
        configure_logging(log_level)
        check_writable(json)
        choice = {"predictor": predictor, "compensation": compensation}
        record = _record(source, channel, rate, preload)
        loaded = _load(scene, link, choice, record)
        drive = loaded.display.drive
        if emulated or ports or (drive is not None and drive.kind == "stepdir"):
            # Imported here: other scenes do without serial ports.
            from telepulse.cli.boards import prepare_boards

            load = partial(_load, link=link, choice=choice, record=record)
            loaded = prepare_boards(stack, loaded, ports, emulated, yes, console, load)
        provenance = scene_provenance(loaded)
        summary = run_demo(loaded, choice, record, seconds, ui, page, console)
    title = f"demo of {source or loaded.path.stem}, {seconds:g} s"
    raise SystemExit(conclude(PROGRAM, summary, title, console, json, provenance, details))


def _record(
    source: Path | None, channel: str | None, rate: str | None, preload: str | None
) -> dict[str, str | None]:
    """Return the options of a record by their names, as a sensing node takes them."""
    path = None if source is None else str(source)
    return {"source": path, "channel": channel, "rate": rate, "preload": preload}


def _load(
    scene: str,
    link: str | None,
    choice: Mapping[str, str | None],
    record: Mapping[str, str | None],
) -> Scene:
    return load_scene(
        scene,
        choice,
        source=record["source"],
        channel=record["channel"],
        rate=record["rate"],
        preload=record["preload"],
        link=link or {},
    )


def run_demo(
    scene: Scene,
    choice: Mapping[str, str | None],
    record: Mapping[str, str | None],
    seconds: float,
    draw: bool,
    page: bool | None,
    console: Console,
) -> Summary:
    """Run both nodes for `seconds` of pulse, over the scene's link.

    choice, record: options of display node and sensing node that `scene` was loaded with, by name.
    page: True serves the live page; None serves it if `draw` is set, and only logs a warning where
    that fails. Raises SceneError, SourceError, ProcessError, or OutputError where a required page
    cannot be served.
    """
    path = scene.path
    # The source is checked before the display starts, since a display may move a drive.
    with open_source(scene.sensing, path.parent) as source:
        log_repetition(source, seconds)
        stream = describe_stream(scene.sensing, source)
    errors = TrueErrors(scene, stream, real_benches=True)
    # At the first start on a machine this compiles for seconds: before a process waits for another.
    scene.display.predictor.build(scene.display.tick_ns, 1)
    sensing_address, telemetry_address, link_address = free_addresses(3)
    impaired = scene.link != LinkScene()
    display_address = link_address if impaired else sensing_address
    with tempfile.TemporaryDirectory(prefix="telepulse-") as folder, ExitStack() as stack:
        live_page = None
        if page or (page is None and draw):
            # Started first, so that it shows the beginning.
            live_page = open_page(stack, telemetry_address, bool(page), console)
        display = LoggedNode(
            *("display node", "display_node.cli", str(path), "--connect", display_address),
            *("--telemetry", telemetry_address, "--once", "--quiet"),
            *_given(choice),
            summary=Path(folder, "display.json"),
        )
        stack.callback(display.stop)
        link_process = None
        if impaired:
            link_process = LoggedProcess(
                *("link between the nodes", "-m", "telepulse", "link"),
                *("--connect", sensing_address, "--bind", display_address),
                *("--link", scene.link.text()),
            )
            stack.callback(link_process.stop)
        context: sockets.Context = zmq.Context()
        stack.callback(context.destroy, linger=0)
        if draw:
            console.print("waiting for the display", soft_wrap=True)
        _await_telemetry(display, sockets.connect(context, zmq.SUB, telemetry_address))
        sensing = LoggedNode(
            *("sensing node", "sensing_node.cli", str(path), "--bind", sensing_address),
            *("--seconds", str(seconds), "--quiet", *_given(record)),
            summary=Path(folder, "sensing.json"),
        )
        stack.callback(sensing.stop)
        # The nodes run: what follows only compares and shows them.
        lower_priority()
        # Ctrl-C ends the pulse; samples that were sent are still played and counted.
        stop_on_signals(sensing.terminate)
        sent = sockets.connect(context, zmq.SUB, sensing_address)
        sent.subscribe(b"")

        ends_by_s = math.inf

        def keep_watching() -> bool:
            nonlocal ends_by_s
            for (message,) in sockets.receive_multipart(sent):
                errors.add_sent(decode_frame(message))
            if link_process is not None:
                link_process.check()
            sensing.check(may_end_with=[0, FAULT_STATUS])
            display.check(may_end_with=[0, FAULT_STATUS, NOT_VALID_STATUS])
            if sensing.returncode is not None:
                ends_by_s = min(ends_by_s, time.monotonic() + ENDS_WITHIN_S)
            if time.monotonic() > ends_by_s:
                # The end of the stream has not reached it.
                display.terminate()
                return False
            return display.returncode is None

        def add_felt(traces: list[Trace]) -> None:
            felt = traces[0].full
            now_ns, instant_ns = traces[0].now_ns[felt], traces[0].instant_ns[felt]
            # Both nodes are on this host, whose clock is the sensing clock as well.
            errors.add_felt(now_ns, now_ns, instant_ns, [each.felt_n[felt] for each in traces])

        watch(telemetry_address, console, add_felt, draw, keep_watching)
        keep_watching()
        if live_page is not None and live_page.poll() is not None:
            logger.warning("the live page ended before the demo did")
        if link_process is not None:
            # A link process that has failed before keeps its exit status.
            link_process.terminate()
            link_process.await_end(ENDS_WITHIN_S)
        played = display.await_summary(ENDS_WITHIN_S, may_end_with=[FAULT_STATUS])
        if not played.availability.ended and not played.faults:
            # It has ended properly, but not at the stream's end.
            display.check()
        sensed = sensing.await_summary(ENDS_WITHIN_S, may_end_with=[FAULT_STATUS])
        return errors.finish(_compose(sensed, played, link_process is not None))


def _await_telemetry(display: LoggedNode, telemetry: sockets.Socket) -> None:
    """Wait until the display publishes: its drives have found their homes before.

    Raises ProcessError where it ends before that.
    """
    telemetry.subscribe(b"")
    while not sockets.has_message(telemetry):
        display.check()
        sockets.wait_readable([telemetry], POLL_NS)
    telemetry.close()


def _given(options: Mapping[str, str | None]) -> list[str]:
    return [f"--{name}={value}" for name, value in options.items() if value is not None]


def _compose(sensing: Summary, display: Summary, over_a_link: bool) -> Summary:
    """Return the display's summary with what the sensing node counts.

    over_a_link: whether a link is between the nodes. It may lose the last answers to set-points,
    or deliver them after the display has ended.

    Raises ProcessError where the two nodes' sample counts differ.
    """
    sent = sensing.samples.sent
    if display.clock.offset_ms is None:
        raise ProcessError("the display received nothing from the sensing node")
    accounted = (display.samples.sent or 0) + (display.samples.before_joining or 0)
    if sent != accounted:
        reason = f"the sensing node sent {sent} samples, the display accounts for {accounted}"
        raise ProcessError(reason)
    if (lacking := _unaccounted(sensing.press, display.press, over_a_link)) is not None:
        raise ProcessError(lacking)
    return replace(
        with_sensing_node(display, sensing),
        press=_account(sensing.press, display.press),
        rejected=dict(Counter(display.rejected) + Counter(sensing.rejected)),
        rejected_readers=dict(
            Counter(display.rejected_readers) + Counter(sensing.rejected_readers)
        ),
    )


def _account(wrist: PressFigures, finger: PressFigures) -> PressFigures:
    """Return the finger's figures with the wrist's account, which no lost answer hides."""
    if finger.sent is None or wrist.applied is None or wrist.superseded is None:
        return finger
    lost = finger.sent - wrist.applied - wrist.superseded
    return replace(finger, applied=wrist.applied, superseded=wrist.superseded, lost=lost)


def _unaccounted(wrist: PressFigures, finger: PressFigures, over_a_link: bool) -> str | None:
    """Return how the two nodes' accounts of the set-points contradict each other, if they do.

    Without the last answers, the finger counts set-points as lost that the wrist has taken.
    """
    if finger.sent is None:
        return None
    parts = finger.applied, finger.superseded, finger.lost
    if finger.sent != sum(part or 0 for part in parts):
        return f"of {finger.sent} set-points, the display accounts for {parts}"
    taken = (wrist.applied or 0) + (wrist.superseded or 0)
    if taken > finger.sent:
        return f"of {finger.sent} set-points, the wrist has taken {taken}"
    for outcome in ("applied", "superseded"):
        known, done = getattr(finger, outcome) or 0, getattr(wrist, outcome) or 0
        if known > done or (known < done and not over_a_link):
            return f"the wrist counts {done} set-points {outcome}, the display {known}"
    return None
