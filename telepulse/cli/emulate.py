"""`telepulse emulate`: emulated hardware, one command for each device."""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import typer

from display_node.plant.contact import ContactLaw
from display_node.plant.scene import StepperScene
from display_node.scene import DisplayScene
from protocol.cli_options import LogLevelOption, StopAfterOption, one_line_errors, plain_console
from protocol.config.quantities import count_text
from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene, scene_names
from protocol.errors import SceneError
from protocol.host.output import configure_logging
from protocol.host.process import freeze_objects, stop_on_signals
from pulse_drives.scene import Cia402Scene, DriveScene, TmclScene, open_bus
from pulse_drives.stepdir.scene import StepdirScene
from pulse_sensors.binary_frames import MAX_SAMPLES, SampleFormat
from pulse_sensors.drive_film import DriveFilmScene
from sensing_node.scene import SensingScene, build_source
from sensing_node.sources.wrist import WristScene, WristSensors
from telepulse.cli.options import PROGRAM, ContactorOption
from telepulse.emulators import PtyPort
from telepulse.emulators.drive_run import FILM_SILENT, MOTOR_FAULTS, DriveRun
from telepulse.emulators.motor import EmulatedMotor
from telepulse.emulators.sensor_board import (
    LINES,
    BoardBehaviour,
    SensorBoard,
    binary,
    play,
    source_table,
)
from telepulse.emulators.tmcl import (
    ANSWER_FAULTS,
    EmulatedCanLine,
    EmulatedSerialLine,
    EmulatedTmclModule,
)
from telepulse.emulators.wrist import TissueContact
from telepulse.scene import DEFAULT_SCENE

FOREVER_S = 1e9
POLL_S = 0.001
TMCL_FAULTS = (*MOTOR_FAULTS, FILM_SILENT, *ANSWER_FAULTS, "unplugged")
STEPDIR_FAULTS = (*MOTOR_FAULTS, FILM_SILENT, "silent", "garbled", "reset", "unplugged")
CIA402_FAULTS = (*MOTOR_FAULTS, FILM_SILENT, "silent", "unplugged")
SceneT = TypeVar("SceneT", bound=DriveScene)

app = typer.Typer(
    no_args_is_help=True, help="Emulated hardware that sends and receives the real devices' bytes."
)


DriveArgument = Annotated[
    str,
    typer.Argument(
        help="A scene whose [display.drive] is of this kind, as file or name.",
        autocompletion=scene_names,
    ),
]
STILL_NOISE_N = 0.5e-3
_TO_PORT = "Create this symbolic link to the port, for the scene's `port`."
LinkOption = Annotated[Path | None, typer.Option(metavar="PATH", help=_TO_PORT)]
_TO_FILM = (
    "Create PATH as a link to a serial port on which a sensor board sends the force under the"
    ' finger, in framing = "binary".'
)
FilmLink = Annotated[Path | None, typer.Option(metavar="PATH", help=_TO_FILM)]
_WRIST = (
    "Emulate the probe's drive, [sensing.press.drive], over the wrist of this scene's source; the"
    " board on --film-link then sends film and load cell."
)
WristOption = Annotated[
    str | None, typer.Option(metavar="SCENE", help=_WRIST, autocompletion=scene_names)
]
_AFTER = "Time from the first press on the finger to the fault."
AfterOption = Annotated[float, typer.Option("--fault-after", min=0, metavar="SECONDS", help=_AFTER)]
_FROM_START = "Begin the fault at the start, in place of --fault-after."
FromStartOption = Annotated[bool, typer.Option("--fault-from-start", help=_FROM_START)]
_TRACE = "Write a CSV line every ms: position, speed, force under the finger, fault."
TraceOption = Annotated[Path | None, typer.Option(metavar="FILE", help=_TRACE)]


def _fault_option(names: tuple[str, ...]) -> Any:
    return typer.Option(
        "--fault",
        metavar="NAME",
        help=f"Fault, which begins at --fault-after: {', '.join(names)}.",
    )


@app.command()
def sensor(
    scene: Annotated[
        str,
        typer.Argument(help="Its source is what the board senses.", autocompletion=scene_names),
    ] = DEFAULT_SCENE,
    link: LinkOption = None,
    framing: Annotated[
        Literal["binary", "text", "untimed"],
        typer.Option(help="Frames, lines of time and value, or lines of a value alone."),
    ] = "binary",
    samples: Annotated[
        SampleFormat, typer.Option(help="Format in binary frames; integers count 0.1 mN.")
    ] = "float32",
    frame: Annotated[int, typer.Option(min=1, max=MAX_SAMPLES, help="Samples in a frame.")] = 4,
    delivery_ms: Annotated[
        float,
        typer.Option(
            min=0,
            max=1000,
            help="Longest time between two deliveries by USB; the shortest is a quarter of it.",
        ),
    ] = 16.0,
    skew_ppm: Annotated[
        float,
        typer.Option(
            min=-10_000, max=10_000, help="Deviation of the board's crystal; positive is fast."
        ),
    ] = 50.0,
    noise: Annotated[
        float, typer.Option(min=0, max=1, help="Share of bytes that noise alters.")
    ] = 0.0,
    still: Annotated[
        bool,
        typer.Option(
            "--still",
            help="Send no pulse, as a sensor that nothing presses: for telepulse bench.",
        ),
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Seed of deliveries and noise.")] = 1,
    seconds: StopAfterOption = None,
    log_level: LogLevelOption = None,
) -> None:
    """Emulate, on a pseudo-terminal, a sensor board that sends the samples of a scene's source.

    Prints the TOML table that a scene needs to read this board. The board samples by its own
    crystal, USB delivers in batches, and noise alters bytes. Stopping the program disconnects the
    board; starting it with the same --link connects the board again.
    """
    console, stopped = plain_console(), threading.Event()
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
        # A real board sends its readings, plausible or not.
        source = build_source(
            _unpressed(section) if still else section, path.parent, plausible=False
        )
        encode = binary(samples, source.channels) if framing == "binary" else LINES[framing]
        board = SensorBoard(source, encode, behaviour, time.perf_counter_ns())
        port = PtyPort(link)
    stop_on_signals(stopped.set)
    with closing(port):
        table = source_table(port.path, board.rate_hz, framing, samples, board.channels)
        console.print(table, markup=False)
        freeze_objects()
        play(
            board,
            port,
            time.perf_counter_ns() + round((seconds or FOREVER_S) * 1e9),
            stopped.is_set,
        )
    console.print(
        f"{count_text(board.sampled, 'sample')} sent,"
        f" {count_text(port.dropped, 'byte')} that nobody read"
    )


def _unpressed(section: SensingScene) -> SensingScene:
    """Return the section of a sensor that nothing presses, with noise. Raises SceneError."""
    unpressed = section.still()
    if unpressed is None:
        raise SceneError(f"--still: a source of kind {section.source.kind!r} always has a pulse")
    source = unpressed.source
    # A reading that never changes is no sensor's. Not every kind of source has a noise.
    if getattr(source, "noise_n", None) == 0.0:
        noisy = source.model_copy(update={"noise_n": STILL_NOISE_N})
        unpressed = unpressed.model_copy(update={"source": noisy})
    return unpressed


@app.command()
def tmcl(
    scene: DriveArgument,
    contactor: ContactorOption = None,
    wrist: WristOption = None,
    link: LinkOption = None,
    film_link: FilmLink = None,
    fault: Annotated[str | None, _fault_option(TMCL_FAULTS)] = None,
    fault_after: AfterOption = 0.0,
    fault_from_start: FromStartOption = False,
    trace: TraceOption = None,
    seconds: StopAfterOption = None,
    log_level: LogLevelOption = None,
) -> None:
    """Emulate a TMCL stepper module on a serial port of its own, or on the scene's CAN bus.

    A physical model of the scene's [display.actuator] turns under a finger, with a home switch,
    the module's heartbeat, its limits and its faults.
    """
    with one_line_errors(PROGRAM), ExitStack() as open_things:
        configure_logging(log_level)
        _check_fault(fault, TMCL_FAULTS)
        drive, motor, board = _load(scene, contactor, wrist, TmclScene)
        module = EmulatedTmclModule(drive, motor)
        cable = open_things.enter_context(ExitStack())
        serve: Callable[[float], None]
        if drive.port is not None:
            port = cable.enter_context(closing(PtyPort(link)))
            serve, place = EmulatedSerialLine(module, port).serve, str(port.path)
        elif link is not None:
            raise SceneError("--link: the scene's module is on a CAN bus, not on a serial port")
        else:
            bus = open_bus(drive)
            cable.callback(bus.shutdown)
            serve = EmulatedCanLine(module, drive, bus).serve
            place = f"CAN {drive.interface} {drive.channel}, identifier {drive.module}"

        def begin_fault(name: str) -> None:
            nonlocal serve
            if name in ANSWER_FAULTS:
                module.answer_mode = name
            else:  # Unplugged.
                serve = time.sleep
                cable.close()

        def poll() -> None:
            serve(POLL_S)
            motor.advance(time.perf_counter_ns())

        run = DriveRun(motor, film_link, trace, open_things, board)
        _say(f"TMCL module on {place}", film_link)
        after_s = None if fault_from_start else fault_after
        run.run(poll, begin_fault, fault, after_s, seconds)


@app.command()
def cia402(
    scene: DriveArgument,
    contactor: ContactorOption = None,
    wrist: WristOption = None,
    interface: Annotated[
        str | None, typer.Option(help="CAN interface as python-can names it; default: the scene's.")
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Channel of the CAN interface.")] = None,
    film_link: FilmLink = None,
    fault: Annotated[str | None, _fault_option(CIA402_FAULTS)] = None,
    fault_after: AfterOption = 0.0,
    fault_from_start: FromStartOption = False,
    trace: TraceOption = None,
    seconds: StopAfterOption = None,
    log_level: LogLevelOption = None,
) -> None:
    """Emulate a CANopen drive of profile CiA 402 on a CAN bus.

    A physical model of the scene's [display.actuator] turns under a finger, with a home switch,
    software limits, heartbeat monitoring and faults. With --fault silent it receives and sends
    nothing.
    """
    # Imported here: it needs a library that the other emulators do without.
    from telepulse.emulators.cia402 import EmulatedCia402Node

    with one_line_errors(PROGRAM), ExitStack() as open_things:
        configure_logging(log_level)
        _check_fault(fault, CIA402_FAULTS)
        drive, motor, board = _load(scene, contactor, wrist, Cia402Scene)
        changes = {"interface": interface, "channel": channel}
        drive = drive.model_copy(update={key: to for key, to in changes.items() if to})
        node = EmulatedCia402Node(drive, motor, open_bus(drive))
        cable = open_things.enter_context(ExitStack())
        cable.callback(node.close)

        def begin_fault(name: str) -> None:
            node.silent = True
            if name == "unplugged":
                cable.close()

        def poll() -> None:
            time.sleep(POLL_S)
            node.poll()

        run = DriveRun(motor, film_link, trace, open_things, board)
        _say(f"CiA 402 node {drive.node} on CAN {drive.interface} {drive.channel}", film_link)
        after_s = None if fault_from_start else fault_after
        run.run(poll, begin_fault, fault, after_s, seconds)


@app.command()
def stepdir(
    scene: DriveArgument,
    contactor: ContactorOption = None,
    wrist: WristOption = None,
    link: LinkOption = None,
    film_link: FilmLink = None,
    fault: Annotated[str | None, _fault_option(STEPDIR_FAULTS)] = None,
    fault_after: AfterOption = 0.0,
    fault_from_start: FromStartOption = False,
    trace: TraceOption = None,
    seconds: StopAfterOption = None,
    log_level: LogLevelOption = None,
) -> None:
    """Emulate telepulse's own display board on a serial port, with its motor and its film.

    The board runs its own sketch, which a C++ compiler makes for this machine at the first time, at
    a physical model of the scene's [display.actuator] under a finger, with a home switch. The film
    that the scene's [display.feedback] of kind "drive" describes comes on the same port.
    """
    # Imported here: it needs a library that the other emulators do without.
    from telepulse.emulators.stepdir import EmulatedBoard, serve_board

    with one_line_errors(PROGRAM), ExitStack() as open_things:
        configure_logging(log_level)
        _check_fault(fault, STEPDIR_FAULTS)
        drive, stepper, law, sensors = _load_plant(scene, contactor, wrist, StepdirScene)
        film, noise_n = (None, 0.0) if wrist else _load_film(scene, contactor)
        board = EmulatedBoard(drive, stepper, law, film, time.perf_counter_ns(), noise_n)
        cable = open_things.enter_context(ExitStack())
        port = cable.enter_context(closing(PtyPort(link)))
        serve = serve_board(board, port)

        def begin_fault(name: str) -> None:
            nonlocal serve
            if name == "reset":
                board.restart()
            elif name == "unplugged":
                serve = time.sleep
                cable.close()
            else:
                board.trouble = name

        def poll() -> None:
            serve(POLL_S)
            board.advance(time.perf_counter_ns())

        run = DriveRun(board, film_link, trace, open_things, sensors)
        _say(f"display board on {port.path}", film_link)
        after_s = None if fault_from_start else fault_after
        run.run(poll, begin_fault, fault, after_s, seconds)


def _load_film(name: str, contactor: str | None) -> tuple[DriveFilmScene | None, float]:
    """Return the film that the drive of a scene's contactor reads, if it reads one, and its noise.

    The noise is that of `[display.film]`, in N RMS.
    """
    display = load_section(find_scene(name), "display", DisplayScene).choose(contactor)
    film = display.feedback if isinstance(display.feedback, DriveFilmScene) else None
    return film, display.film.noise_n


def _check_fault(fault: str | None, names: tuple[str, ...]) -> None:
    if fault is not None and fault not in names:
        raise SceneError(f"--fault: no {fault!r}; there are {', '.join(names)}")


def _load(
    name: str, contactor: str | None, wrist: str | None, kind: type[SceneT]
) -> tuple[SceneT, EmulatedMotor, WristSensors | None]:
    """Return the drive of a scene's contactor or probe, its motor, and the sensors at a wrist."""
    drive, stepper, law, sensors = _load_plant(name, contactor, wrist, kind)
    return drive, EmulatedMotor(stepper, law, drive.touch_m, time.perf_counter_ns()), sensors


def _load_plant(
    name: str, contactor: str | None, wrist: str | None, kind: type[SceneT]
) -> tuple[SceneT, StepperScene, ContactLaw, WristSensors | None]:
    """Return the drive of a scene's contactor or probe, its motor's table, and what it presses.

    wrist: name of the scene of the wrist under the probe, whose sensors are returned too.
    """
    path = find_scene(name)
    if wrist is not None:
        return _load_probe(path, find_scene(wrist), kind)
    display = load_section(path, "display", DisplayScene).choose(contactor)
    drive = kind.narrow(display.drive, f"{path}: [display.drive]")
    if (stepper := display.actuator.stepper) is None:
        raise SceneError(f'{path}: a drive needs [display.actuator] kind = "stepper"')
    return drive, stepper, stepper.contact(display.layer.layer()), None


def _load_probe(
    path: Path, wrist: Path, kind: type[SceneT]
) -> tuple[SceneT, StepperScene, ContactLaw, WristSensors]:
    """Return the drive of a scene's probe, its motor's table, and tissue and sensors of a wrist."""
    press = load_section(path, "sensing", SensingScene).press
    source = WristScene.narrow(
        load_section(wrist, "sensing", SensingScene).source, f"--wrist {wrist}: [sensing.source]"
    )
    drive = kind.narrow(None if press is None else press.drive, f"{path}: [sensing.press.drive]")
    assert press is not None
    stepper = StepperScene.model_validate({"kind": "stepper"})
    stepper = stepper.model_copy(update=press.motor.model_dump())
    return drive, stepper, TissueContact(source), WristSensors(source)


def _say(what: str, film_link: Path | None) -> None:
    plain_console().print(what + (f"; film on {film_link}" if film_link else ""))
