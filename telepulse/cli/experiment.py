"""`telepulse experiment`: run blinded trials."""

from contextlib import ExitStack, closing
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer

from protocol.cli_options import (
    BENCH_IS_CLEAR,
    LogLevelOption,
    RealtimeOption,
    apply_and_log_realtime,
    one_line_errors,
    plain_console,
)
from protocol.config.quantities import parse_ratio
from protocol.errors import SceneError
from protocol.host.output import configure_logging, create_file, unblocked_output
from protocol.host.process import freeze_objects, stop_on_signals
from protocol.host.realtime import check_strict, parse_realtime
from telepulse.cli.options import PROGRAM, YesOption

app = typer.Typer(
    no_args_is_help=True, help="Blinded trials: can a finger tell the link from direct playback?"
)
SessionArgument = Annotated[Path, typer.Argument(metavar="SESSION.toml", show_default=False)]


def _threshold(text: str) -> float:
    try:
        share = parse_ratio(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from None
    if not 0 < share <= 100:
        raise typer.BadParameter(f"{text!r} must be more than 0")
    return share


@app.command()
def new(path: SessionArgument) -> None:
    """Write an example of a session file for you to change; nothing is overwritten."""
    text = files("telepulse.experiment").joinpath("example.toml").read_text(encoding="utf-8")
    with one_line_errors(PROGRAM):
        create_file(path, text)
    plain_console().print(f"{path}: change it, then: telepulse experiment run {path} --log LOG")


@app.command()
@unblocked_output()
def run(
    session: SessionArgument,
    log: Annotated[
        Path,
        typer.Option(metavar="FILE.jsonl", help="Write each trial here as soon as it is answered."),
    ],
    resume: Annotated[bool, typer.Option("--resume", help="Continue an existing log.")] = False,
    observer: Annotated[
        float | None,
        typer.Option(
            metavar="'5 %'",
            parser=_threshold,
            help="Threshold of a simulated observer that answers in virtual time instead of a"
            " person, as a share of the pulse from peak to peak.",
        ),
    ] = None,
    yes: YesOption = False,
    without_drive: Annotated[
        bool,
        typer.Option(
            "--without-drive",
            help="Run the models of a scene without a drive, to try a session. Nobody feels"
            " anything, and the log records that.",
        ),
    ] = False,
    realtime: RealtimeOption = None,
    log_level: LogLevelOption = None,
) -> None:
    """Run a session: the subject feels A, B and X on the scene's actuator, and answers by keys.

    A scene with a [display.drive] runs on the real bench. A scene without one is refused for a
    person, who would feel nothing, unless --without-drive is given. At the end of the session it
    prints what was answered by condition; the log has every trial, a JSON object a line.

    Exit status: 0 when it has ended or was stopped by q, 2 when it cannot be run or a fault ends
    it; the reason is one line on stderr.
    """
    from display_node.benches import start_benches
    from telepulse.experiment.log import open_log, read_log, show_results
    from telepulse.experiment.session import load_plan
    from telepulse.experiment.subjects import (
        Keyboard,
        Person,
        check_playable,
        run_session,
        simulated_subject,
    )

    console = plain_console()
    with one_line_errors(PROGRAM), ExitStack() as stack:
        configure_logging(log_level)
        asked = parse_realtime(realtime)
        check_strict(asked)
        plan = load_plan(session)
        if plan.direct.display.contactor:
            raise SceneError(
                f"{plan.direct.path}: [display] contactor: an experiment presses one contactor;"
                " give it a scene without this table"
            )
        if observer is None and not without_drive and plan.direct.display.drive is None:
            raise SceneError(
                f"{plan.direct.path}: has no [display.drive], so nobody would feel anything:"
                " --without-drive runs its models, to try a session"
            )
        file, header, done = open_log(log, plan, observer, resume)
        stack.enter_context(closing(file))
        if observer is not None:
            subject = simulated_subject(plan, observer, header.seed)
        else:
            scene = plan.direct
            check_playable(plan, header)
            keyboard = stack.enter_context(Keyboard())
            person = Person(plan, keyboard, console.print)
            if scene.display.drive is not None and not yes:
                console.print(f"The drive will move.\n{BENCH_IS_CLEAR} [y/N]")
                if keyboard.await_key() != "y":
                    raise SystemExit(1)
            freeze_objects()
            # Started last: everything that can fail without the drive fails before it moves.
            benches = start_benches(scene.display, scene.path.parent)
            (hardware,) = stack.enter_context(benches)
            if hardware is not None:
                person.use(hardware)
            stop_on_signals(person.stop)
            stack.enter_context(apply_and_log_realtime(PROGRAM, asked))
            subject = person.answer
        finished = run_session(plan, file, header, done, subject)
    if not finished:
        console.print(f"stopped; continue: telepulse experiment run {session} --log {log} --resume")
        return
    show_results(read_log(log), console)
