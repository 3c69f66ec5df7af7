"""The two boards of `telepulse demo`: found at their ports, or emulated, and checked once."""

import json
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from itertools import cycle
from pathlib import Path
from subprocess import PIPE
from tempfile import TemporaryDirectory
from typing import Literal, NamedTuple

import serial
import typer
from rich.console import Console
from serial.tools import list_ports

from protocol.cli_options import BENCH_IS_CLEAR
from protocol.errors import ProcessError, SceneError, SourceError
from protocol.host.child_process import ChildProcess
from protocol.host.process import interrupt_on_signals
from pulse_drives.stepdir.frames import SENSOR_FORMATS, Format, board_reader
from pulse_drives.stepdir.scene import StepdirScene
from pulse_sensors.serial_port import SerialScene
from telepulse.cli.options import KEEP_AWAY, PROGRAM
from telepulse.emulators import sketch
from telepulse.emulators.sensor_board import COUNTS
from telepulse.processes import prefer
from telepulse.scene import Scene

End = Literal["wrist", "finger"]
# Of Arduino (two), Raspberry Pi, and the adapters CH340, FTDI and CP210x.
USB_VENDORS = frozenset((0x2341, 0x2A03, 0x2E8A, 0x1A86, 0x0403, 0x10C4))
# Opening a port resets many boards, and a bootloader waits up to 2 s before it starts them.
IDENTIFIED_WITHIN_S = 4.0
# At one rate, before another is tried.
LISTENED_S = 0.3
WAIT_S = 0.05
READ_BYTES = 4096
# At a wrong rate one may be chance, since a CRC has 16 bits.
FRAMES = 2
CHECK_FAILED_STATUS = 1
CHECKED_FOR_S = 5.0
PRESSED_WITH_N = 0.3
STARTS_WITHIN_S = 30.0
# The first samples of an emulated board come late, since its program still starts.
SETTLED_S = 1.0
ENDS_WITHIN_S = 5.0
# The scene whose source the emulated board senses; see `telepulse emulate sensor`.
EMULATED_SENSOR = ("sensor", "bench", "--samples", "int16", "--delivery-ms", "4")
NAME_THEM = (
    "--ports WRIST FINGER names them, or `port` of [sensing.source] and [display.drive] in a copy"
    " of the scene; --emulated plays emulated boards"
)
WHAT_HAPPENS = (
    "The finger's board is on {finger}, the wrist's on {wrist}.\n"
    "First the bench is checked, with nothing on the wrist's film: the drive seeks home and presses"
    " with up to {force:g} N. " + KEEP_AWAY
)
COMPILED = (
    "the finger's board is its own sketch, compiled for this machine; the wrist's is emulated byte"
    " for byte"
)
READY = (
    "Put the film on the wrist. The drive seeks home once more, and presses the dummy with up to"
    " {force:g} N: keep fingers away. Play?"
)


class SeenPort(NamedTuple):
    """A serial port; end: that of the board on it, None where it is not known, for a `reason`."""

    port: str
    end: End | None
    reason: str = ""

    def __str__(self) -> str:
        """Return the port with what was found there."""
        return f"{self.port} ({self.reason if self.end is None else f'the {self.end}'})"


def identify(port: str, bauds: Sequence[int]) -> SeenPort:
    """Return a port with the end whose board sends there, at one of some rates."""
    until_s = time.monotonic() + IDENTIFIED_WITHIN_S
    try:
        with serial.serial_for_url(port, bauds[0], timeout=WAIT_S, exclusive=True) as line:
            for baud in cycle(bauds):
                line.baudrate = baud
                if (end := _sender(line)) is not None:
                    return SeenPort(port, end)
                if time.monotonic() > until_s:
                    break
    except (OSError, ValueError) as error:
        return SeenPort(port, None, f"cannot be read: {error}")
    return SeenPort(port, None, "no board of telepulse sends there")


def _sender(line: serial.Serial) -> End | None:
    """Return the end whose board sends on a line: a finger's states, or a wrist's samples."""
    reader, frames = board_reader(), Counter[End]()
    until_s = time.monotonic() + LISTENED_S
    while time.monotonic() < until_s:
        for body in reader.feed(line.read(READ_BYTES)):
            if body[0] == Format.STATE:
                frames["finger"] += 1
            elif body[0] >= SENSOR_FORMATS:
                frames["wrist"] += 1
        for end, count in frames.items():
            if count >= FRAMES:
                return end
    return None


def find_ports(ends: Sequence[End], bauds: Sequence[int]) -> dict[End, str]:
    """Return the port of each end's board, by USB ids and by what it sends; ask where unclear.

    Raises SourceError where there is no board, or nobody at a terminal to ask.
    """
    ports = sorted(each.device for each in list_ports.comports() if each.vid in USB_VENDORS)
    if not ports:
        raise SourceError(f"no board was found at a USB port; {NAME_THEM}")
    seen = [identify(port, bauds) for port in ports]
    candidates = {end: [each.port for each in seen if each.end == end] for end in ends}
    unclear = [end for end, found in candidates.items() if len(found) != 1]
    if unclear:
        shown = ", ".join(map(str, seen))
        if not sys.stdin.isatty():
            boards = " and ".join(f"the {end}'s board" for end in unclear)
            raise SourceError(f"no port, or several, for {boards}: {shown}; {NAME_THEM}")
        print(f"serial ports: {shown}")
        for end in unclear:
            candidates[end] = [typer.prompt(f"Port of the {end}'s board")]
    return {end: port for end, (port,) in candidates.items()}


def prepare_boards(
    stack: ExitStack,
    scene: Scene,
    ports: tuple[str, str] | None,
    emulated: bool,
    yes: bool,
    console: Console,
    reload: Callable[[str], Scene],
) -> Scene:
    """Return a scene with the ports of its boards, on a bench that was checked once.

    stack: ends what is started here. ports: of wrist and finger, where the user names them. yes: do
    not ask before the drive moves. reload: load a scene's file with the command's options.

    Raises SceneError, SourceError or ProcessError; SystemExit where a check failed.
    """
    if emulated and ports is not None:
        raise SceneError("--ports: not with --emulated")
    tables = _tables(scene)
    found = {} if emulated else _ports_of(tables, ports)
    interrupt_on_signals()
    folder = Path(stack.enter_context(TemporaryDirectory(prefix="telepulse-")))
    if emulated:
        found = {end: str(folder / end) for end in tables}
    path = folder / scene.path.name
    path.write_text(_with_ports(scene.path, found, emulated), encoding="utf-8")
    scene = reload(str(path))
    if emulated:
        # Before its emulator starts, which has to do so in time.
        sketch.compiled()
        console.print(COMPILED)
        board = "stepdir", str(scene.path), "--link", str(folder / "finger")
        finger = _emulate(stack, "finger", *board)
        prefer(finger.pid)
        stack.callback(_end, finger, console)
        sensor = *EMULATED_SENSOR, "--link", str(folder / "wrist")
        still = _emulate(stack, "wrist", *sensor, "--still")
        _check(scene, console)
        still.stop()
        _emulate(stack, "wrist", *sensor)
        return scene
    where = {"wrist": "none, since a recording is played"} | found
    typer.echo(WHAT_HAPPENS.format(force=_press_n(scene), **where), err=True)
    _confirm(BENCH_IS_CLEAR, yes)
    _check(scene, console)
    _confirm(READY.format(force=scene.display.safety.force_limit_n), yes)
    return scene


def _tables(scene: Scene) -> dict[End, StepdirScene | SerialScene]:
    """Return the tables of a scene's boards. Raises SceneError without one at the finger."""
    drive, source = scene.display.drive, scene.sensing.source
    if not isinstance(drive, StepdirScene):
        reason = 'its drive is not of kind "stepdir", as that of class_bench is'
        raise SceneError(f"{scene.path}: no board is at its finger: {reason}")
    tables: dict[End, StepdirScene | SerialScene] = {"finger": drive}
    # A recording may take the place of the wrist's board.
    if isinstance(source, SerialScene):
        tables["wrist"] = source
    return tables


def _ports_of(
    tables: Mapping[End, StepdirScene | SerialScene], given: tuple[str, str] | None
) -> dict[End, str]:
    """Return the ports that are given; else the scene's, where they are there; else those found."""
    named = {end: table.port for end, table in tables.items()}
    if given is not None:
        return {end: given[end == "finger"] for end in named}
    if all(map(_exists, named.values())):
        return named
    return find_ports(list(named), [table.baud for table in tables.values()])


def _exists(port: str) -> bool:
    """Return whether a port that a scene names is there, as far as that can be known."""
    devices = (each.device for each in list_ports.comports())
    return "://" in port or port in devices or Path(port).exists()


def _with_ports(path: Path, ports: dict[End, str], emulated: bool) -> str:
    """Return the text of a scene that extends another by the ports of its boards."""
    lines = [f"extends = {json.dumps(str(path.absolute()))}"]
    if "wrist" in ports:
        keys = {"port": ports["wrist"]} | (COUNTS if emulated else {})
        lines.append("[sensing.source]")
        lines += [f"{key} = {json.dumps(value)}" for key, value in keys.items()]
    lines += ["[display.drive]", f"port = {json.dumps(ports['finger'])}"]
    return "\n".join(lines) + "\n"


def _emulate(stack: ExitStack, end: End, *words: str) -> ChildProcess:
    """Start the emulator of an end's board. Raises ProcessError where it does not start."""
    command = ("-m", "telepulse", "emulate", *words, "--log-level", "warning")
    emulator = ChildProcess(f"emulated board of the {end}", *command, stdout=PIPE, stderr=PIPE)
    stack.callback(emulator.stop)
    emulator.read_line(STARTS_WITHIN_S)
    time.sleep(SETTLED_S)
    return emulator


def _end(emulator: ChildProcess, console: Console) -> None:
    """End an emulator, and show its warnings: that this machine kept it waiting."""
    emulator.terminate()
    # Of one that has failed, the display names the fault.
    with suppress(ProcessError):
        console.print(emulator.await_end(ENDS_WITHIN_S), markup=False, end="")


def _confirm(question: str, yes: bool) -> None:
    if not yes and not typer.confirm(question, err=True):
        typer.echo("not started: answer y to go on", err=True)
        raise SystemExit(CHECK_FAILED_STATUS)


def _press_n(scene: Scene) -> float:
    return min(PRESSED_WITH_N, scene.display.safety.force_limit_n)


def _check(scene: Scene, console: Console) -> None:
    """Check sensors and drive as `telepulse bench` does; end the program where a check fails."""
    # Imported here: scipy takes long to import, and other demos do without.
    from telepulse.commissioning import bench_check

    findings, folder = bench_check.BenchFindings(), scene.path.parent
    console.print("checking the bench")
    if isinstance(scene.sensing.source, SerialScene):
        bench_check.check_wrist(findings, scene.sensing, folder, CHECKED_FOR_S)
    display = scene.display.choose(None)
    bench_check.check_display(findings, display, folder, _press_n(scene), CHECKED_FOR_S)
    bench_check.check_loop(findings, scene.path)
    counts = Counter(check.verdict for _, check in findings.checks)
    console.print("checks: " + ", ".join(f"{count} {verdict}" for verdict, count in counts.items()))
    for part, check in findings.checks:
        line = f"{part}: {check.name}: {'; '.join(filter(None, (check.text, check.reason)))}"
        if check.verdict == "warn":
            console.print(f"  warn: {line}")
        elif check.verdict == "fail":
            print(f"{PROGRAM}: the check of the bench failed: {line}", file=sys.stderr)
    if findings.failed:
        raise SystemExit(CHECK_FAILED_STATUS)
