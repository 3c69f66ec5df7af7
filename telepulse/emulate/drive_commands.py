"""`telepulse emulate tmcl` and `cia402`: a drive that is not there, for the real driver to move."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from enum import Enum
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from display_node.actuators.stepper import StepperScene
from display_node.drives.can_bus import open_bus
from display_node.drives.scene import Cia402Scene, DriveScene, TmclScene
from display_node.scene import DisplayScene
from protocol.commands import StopAfterOption, one_line_errors, plain_console
from protocol.errors import SceneError
from protocol.scene import load_section
from protocol.signals import stop_on_signals
from telepulse.emulate.film import EmulatedFilm
from telepulse.emulate.motor import EmulatedMotor, Fault
from telepulse.emulate.pty_port import PtyPort
from telepulse.emulate.tmcl_module import Answer, EmulatedModule
from telepulse.scene import find_scene

PROGRAM = "telepulse"
POLL_S = 0.001
SceneT = TypeVar("SceneT", bound=DriveScene)


class TmclTrouble(Enum):
    """What can go wrong with an emulated TMCL module: with its motor, or with its replies."""

    OVERTEMPERATURE = "overtemperature"
    FOLLOWING_ERROR = "following-error"
    SILENT = "silent"
    LATE = "late"
    WRONG = "wrong"
    GARBLED = "garbled"


class Cia402Trouble(Enum):
    """What can go wrong with an emulated CiA 402 drive."""

    OVERTEMPERATURE = "overtemperature"
    FOLLOWING_ERROR = "following-error"
    SILENT = "silent"


_MOTOR_FAULTS: dict[str, Fault] = {
    "overtemperature": "overtemperature",
    "following-error": "following error",
}
_ANSWERS: dict[str, Answer] = {
    "silent": "none",
    "late": "late",
    "wrong": "wrong",
    "garbled": "garbled",
}

SceneArgument = Annotated[
    str, typer.Argument(help="A scene whose [display.drive] is of this kind, as file or name.")
]
FilmOption = Annotated[
    Path | None,
    typer.Option(
        metavar="PATH",
        help="Make PATH a serial port on which a sensor board sends the force under the finger,"
        ' in framing = "binary".',
    ),
]
TROUBLE = typer.Option("--fault", help="What goes wrong, at --fault-after.")
AfterOption = Annotated[
    float, typer.Option("--fault-after", min=0, metavar="SECONDS", help="When it goes wrong.")
]


def tmcl(
    scene: SceneArgument,
    link: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Make PATH the serial port, for the scene to name."),
    ] = None,
    film_link: FilmOption = None,
    fault: Annotated[TmclTrouble | None, TROUBLE] = None,
    fault_after: AfterOption = 0.0,
    seconds: StopAfterOption = None,
) -> None:
    """Be a TMCL stepper module: on a serial port of its own, or on the scene's CAN bus.

    A physical model of the scene's [display.actuator] turns under a finger, with a home switch,
    the module's heartbeat, its limits and its faults. --fault: overtemperature, following-error;
    or replies that are silent (missing), late, wrong or garbled.
    """
    # python-can brings its import time; other commands do without.
    from telepulse.emulate.tmcl_line import CanLine, SerialLine

    with one_line_errors(PROGRAM), ExitStack() as open_things:
        drive, motor = _load(scene, TmclScene)
        module = EmulatedModule(drive, motor)
        line: SerialLine | CanLine
        if drive.port is not None:
            port = PtyPort(link)
            line, place = SerialLine(module, port), str(port.path)
        else:
            line = CanLine(module, drive, open_bus(drive))
            place = f"CAN {drive.interface} {drive.channel}, identifier {drive.module}"
        open_things.callback(line.close)

        def break_down() -> None:
            if fault is not None and fault.value in _ANSWERS:
                module.answers = _ANSWERS[fault.value]
            elif fault is not None:
                motor.fail(_MOTOR_FAULTS[fault.value])

        def poll() -> None:
            line.serve(POLL_S)
            motor.advance(time.monotonic_ns())

        film = _film(motor, film_link, open_things)
        _say(f"TMCL module on {place}", film_link)
        _run(poll, film, seconds, break_down, fault_after)


def cia402(
    scene: SceneArgument,
    interface: Annotated[
        str | None, typer.Option(help="CAN interface as python-can names it; else the scene's.")
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Channel of the CAN interface.")] = None,
    film_link: FilmOption = None,
    fault: Annotated[Cia402Trouble | None, TROUBLE] = None,
    fault_after: AfterOption = 0.0,
    seconds: StopAfterOption = None,
) -> None:
    """Be a CANopen drive of profile CiA 402 on a CAN bus.

    A physical model of the scene's [display.actuator] turns under a finger, with a home switch,
    software limits, heartbeat monitoring and faults. --fault: overtemperature, following-error,
    or silent: the drive hears, and says nothing.
    """
    from telepulse.emulate.cia402_node import EmulatedNode

    with one_line_errors(PROGRAM), ExitStack() as open_things:
        drive, motor = _load(scene, Cia402Scene)
        changes = {"interface": interface, "channel": channel}
        drive = drive.model_copy(update={key: to for key, to in changes.items() if to})
        node = EmulatedNode(drive, motor, open_bus(drive))
        open_things.callback(node.close)

        def break_down() -> None:
            node.silent = fault is Cia402Trouble.SILENT
            if fault is not None and not node.silent:
                motor.fail(_MOTOR_FAULTS[fault.value])

        def poll() -> None:
            time.sleep(POLL_S)
            node.poll()

        film = _film(motor, film_link, open_things)
        _say(f"CiA 402 node {drive.node} on CAN {drive.interface} {drive.channel}", film_link)
        _run(poll, film, seconds, break_down, fault_after)


def _load(name: str, kind: type[SceneT]) -> tuple[SceneT, EmulatedMotor]:
    """The scene's drive, and a motor as its actuator says."""
    path = find_scene(name)
    display = load_section(path, "display", DisplayScene)
    if not isinstance(display.drive, kind):
        wanted = "tmcl" if kind is TmclScene else "cia402"
        raise SceneError(f'{path}: [display.drive] kind = "{wanted}" is needed here')
    if not isinstance(display.actuator, StepperScene):
        raise SceneError(f'{path}: a drive needs [display.actuator] kind = "stepper"')
    law = display.actuator.contact(display.layer.layer())
    return display.drive, EmulatedMotor(
        display.actuator, law, display.drive.touch_m, time.monotonic_ns()
    )


def _film(motor: EmulatedMotor, link: Path | None, open_things: ExitStack) -> EmulatedFilm | None:
    if link is None:
        return None
    film = EmulatedFilm(motor, PtyPort(link))
    open_things.callback(film.close)
    return film


def _say(what: str, film_link: Path | None) -> None:
    film = f"; film on {film_link}" if film_link else ""
    plain_console().print(f"{what}{film}")


def _run(
    poll: Callable[[], None],
    film: EmulatedFilm | None,
    seconds: float | None,
    break_down: Callable[[], None],
    break_after_s: float,
) -> None:
    """Poll until stopped or `seconds` are over; something breaks once on the way."""
    stopping = False

    def stop() -> None:
        nonlocal stopping
        stopping = True

    stop_on_signals(stop)
    began_s, whole = time.monotonic(), True
    while not stopping:
        poll()
        if film is not None:
            film.deliver()
        passed_s = time.monotonic() - began_s
        if whole and passed_s >= break_after_s:
            whole = False
            break_down()
        if seconds is not None and passed_s >= seconds:
            return
