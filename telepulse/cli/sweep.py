"""`telepulse sweep`: press a wrist over a range of forces, and find its best hold-down."""

import logging
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated

import typer

from display_node.node import DisplayNode
from display_node.prediction.scene import own_predictor
from display_node.press.scene import PressScene
from display_node.press.sweep import DepthSweep, SweepPlan, SweptLevel
from display_node.scene import DisplayScene
from display_node.telemetry.recorder_process import is_whole, start_recorder
from protocol.cli_options import (
    InsecureOption,
    KeyOption,
    LogLevelOption,
    PeerOption,
    one_line_errors,
    plain_console,
)
from protocol.config.quantities import parse_quantity
from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene
from protocol.errors import DepthError, OptionError
from protocol.host.output import configure_logging
from protocol.host.process import freeze_objects, raise_file_limit, stop_on_signals
from protocol.provenance import collect
from protocol.refusals import explain_causes
from protocol.security.link_keys import KeyOptions
from sensing_node.scene import SensingScene, build_source
from telepulse.cli.options import (
    NOT_WHOLE,
    PROGRAM,
    FolderOption,
    SceneArgument,
    TablesOption,
    publish,
)
from telepulse.cli.view import open_page
from telepulse.document import Report
from telepulse.recording.depth_report import describe_level, report_depth
from telepulse.simulation.simulated_run import sweep_wrist

logger = logging.getLogger(__name__)

# Limits of the options; the probe at the wrist has limits of its own.
LEAST_N, MOST_N = 0.1, 10.0
TELEMETRY = "tcp://127.0.0.1:*"


def sweep(
    scene: SceneArgument = "press",
    connect: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Press the wrist of this sensing node, tcp://HOST:5555. Without it, the scene's"
            " modelled wrist is pressed in virtual time, without a link.",
        ),
    ] = None,
    low: Annotated[str, typer.Option(help="Least hold-down force.")] = "0.2 N",
    high: Annotated[
        str, typer.Option(help="Greatest hold-down force; the probe has a limit of its own.")
    ] = "2.5 N",
    steps: Annotated[
        int, typer.Option(min=4, max=40, help="Levels from the least to the greatest force.")
    ] = 8,
    ramp: Annotated[
        float | None,
        typer.Option(
            min=20,
            max=600,
            metavar="SECONDS",
            help="Press steadily from the least to the greatest force instead, in this time.",
        ),
    ] = None,
    record: Annotated[
        Path | None,
        typer.Option(metavar="FILE.mcap", help="Record the sweep: telepulse replay --press."),
    ] = None,
    page: Annotated[
        bool, typer.Option("--page", help="Serve the live page; its address is printed first.")
    ] = False,
    out: FolderOption = Path("out/sweep"),
    json: TablesOption = None,
    log_level: LogLevelOption = None,
    key: KeyOption = None,
    peer: PeerOption = None,
    insecure: InsecureOption = False,
) -> None:
    """Press a wrist over a range of forces, and find the best hold-down and three levels.

    Each level is held until five good beats have come, at most 9 s; finer levels follow around the
    three. A pulse that is nearly gone is not pressed further. Prints height and shape of the pulse
    at each level, and writes a report. Ctrl-C eases off and reports what there is.

    Exit status: 0 with a report; 1 when its recording is not whole (`--record`); 2 when the wrist
    cannot be pressed, the sweep ended early for another reason than Ctrl-C, or there are too few
    beats; the reason is a line on stderr.
    """
    console = plain_console(json=json)

    def watch(level: SweptLevel) -> None:
        console.print(describe_level(level))

    with one_line_errors(PROGRAM):
        configure_logging(log_level)
        plan = _plan(low, high, steps, ramp)
        path = find_scene(scene)
        run = DepthSweep(plan, watch)
        if connect is None:
            if record is not None or page:
                option = "--page" if record is None else "--record"
                raise OptionError(f"{option} needs --connect: virtual time has no telemetry")
            sensing = load_section(path, "sensing", SensingScene)
            if sensing.sensor is not None or not sensing.modelled.pressable:
                raise OptionError(
                    f'{path}: its source is of kind "{sensing.source.kind}", which only a sensing'
                    " node can press: give --connect ADDRESS, or a scene with a source of kind"
                    ' "wrist"'
                )
            wrist = build_source(sensing, path.parent)
        else:
            display = load_section(path, "display", DisplayScene)
            keys = KeyOptions(key, peer, insecure=insecure).client(connect)

    recorded = True

    def build() -> Report:
        nonlocal recorded
        causes: list[str] = []
        if connect is None:
            sweep_wrist(wrist, run, plan.high_n)
        else:
            raise_file_limit()
            provenance = collect(path, {"display": display})
            node = DisplayNode(
                _without_finger(display, plan),
                [connect],
                TELEMETRY,
                keys,
                provenance=provenance.to_bytes(),
            )
            with closing(node), ExitStack() as stack:
                if page:
                    open_page(stack, node.telemetry_address, True, console)
                with start_recorder(node.telemetry, record, None, []) as recorder:
                    logger.info(f"waiting for {connect}; telemetry on {node.telemetry_address}")
                    node.sweep_with(run)
                    stop_on_signals(run.release)
                    freeze_objects()
                    summary = node.run()
                causes = explain_causes(summary.rejected)
                if not (recorded := is_whole(recorder, summary)):
                    logger.warning(f"{record}: the recording is not whole")
        if run.fault:
            reason = "; ".join((run.fault, *causes))
            raise DepthError(f"the sweep ended after {len(run.levels)} levels: {reason}")
        source = connect or path.stem
        return report_depth(run.curve(), run.levels, run.notes, source, modelled=connect is None)

    publish(build, out, json)
    if not recorded:
        raise SystemExit(NOT_WHOLE)


def _plan(low: str, high: str, steps: int, ramp: float | None) -> SweepPlan:
    """Return the plan that the options describe. Raises OptionError."""
    forces_n = []
    for name, text in (("low", low), ("high", high)):
        try:
            force_n = parse_quantity(text, "force")
        except ValueError as error:
            raise OptionError(f"--{name}: {error}") from None
        if not LEAST_N <= force_n <= MOST_N:
            raise OptionError(f"--{name} {text}: give {LEAST_N:g} N to {MOST_N:g} N")
        forces_n.append(force_n)
    low_n, high_n = forces_n
    if high_n < 2 * low_n:
        raise OptionError(f"--high {high}: give at least twice --low, {low}")
    return SweepPlan(low_n, high_n, steps, None if ramp is None else round(ramp * 1e9))


def _without_finger(scene: DisplayScene, plan: SweepPlan) -> DisplayScene:
    """Return the display of a sweep: models in place of drives, and the sweep's own limit."""
    keys = {"sensor": {"kind": "finger"}, "force_limit": f"{plan.high_n} N"}
    if scene.press is not None:
        keys["channel"] = scene.press.channel
    press = PressScene.model_validate(keys)
    models = {"drive": None, "feedback": None, "contactor": ()}
    return scene.model_copy(update={**models, "press": press, "predictor": own_predictor("hold")})
