"""The firmware of both boards on an emulated ATmega328P: compiled, run, and addressed by frames."""

import json
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pulse_drives.stepdir.frames import (
    SEQUENCE_TURN,
    BoardGreeting,
    BoardMode,
    BoardState,
    CommandAnswer,
    CommandResult,
    Format,
    board_reader,
    decode_report,
    encode_command,
)
from tests.support.nodes import ROOT

FIRMWARE = ROOT / "firmware"
SKETCHES = ("telepulse_display", "telepulse_sensor")
HARNESS = ROOT / "tests" / "support" / "avr"
ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr")
SIMAVR = Path("/usr/include/simavr/sim_avr.h")
CORE = ("main", "HardwareSerial", "HardwareSerial0", "Print", "abi")
WIRING = ("wiring", "wiring_analog", "wiring_digital", "hooks")
# Options of Arduino's builder. Its core is a library, of which the linker takes what is named.
CHIP = "-mmcu=atmega328p -DF_CPU=16000000L -DARDUINO=10819 -Os -ffunction-sections -fdata-sections"
LTO = ("-flto", "-fno-fat-lto-objects")
CPP = "-std=gnu++11 -fno-exceptions -fno-threadsafe-statics"
LINK = "-mmcu=atmega328p -Os -flto -fuse-linker-plugin -Wl,--gc-sections"
WARNINGS = ("-Wall", "-Wextra", "-Werror")
LIBRARIES = ("-lsimavr", "-lelf", "-lm", "-lutil")


def missing() -> str | None:
    """Return what is missing to run a sketch on an AVR core; None where nothing is."""
    if all(map(shutil.which, ("avr-g++", "gcc"))) and ARDUINO.exists() and SIMAVR.exists():
        return None
    return (
        "needs gcc and, of Debian: gcc-avr, avr-libc, arduino-core-avr, libsimavr-dev, libelf-dev"
    )


def compile_or_fail(folder: Path, *command: str) -> None:
    """Run a compiler in a folder; its complaint is the assertion's."""
    made = subprocess.run(command, cwd=folder, capture_output=True, encoding="utf-8", check=False)
    assert made.returncode == 0, made.stderr


def compile_sketch(name: str, folder: Path) -> Path:
    """Compile a sketch of `firmware/` with Arduino's core; return its ELF file."""
    core = ARDUINO / "cores" / "arduino"
    chip = [*CHIP.split(), *LTO, f"-I{core}", f"-I{ARDUINO}/variants/standard"]
    cpp = ["avr-g++", *chip, *CPP.split(), "-c"]
    firmware, sketch = folder / f"{name}.elf", FIRMWARE / name / f"{name}.ino"
    objects = [f"{part}.o" for part in (*CORE, *WIRING)]
    wiring = [str(core / f"{part}.c") for part in WIRING]
    compile_or_fail(folder, "avr-gcc", *chip, "-std=gnu11", "-c", *wiring)
    compile_or_fail(folder, *cpp, *(str(core / f"{part}.cpp") for part in CORE))
    compile_or_fail(
        folder, *cpp, *WARNINGS, "-include", "Arduino.h", "-x", "c++", str(sketch), "-o", "sketch.o"
    )
    compile_or_fail(folder, "avr-gcc-ar", "rcs", "core.a", *objects)
    compile_or_fail(
        folder, "avr-g++", *LINK.split(), "sketch.o", "core.a", "-lm", "-o", str(firmware)
    )
    return firmware


def compile_harness(name: str, folder: Path) -> Path:
    """Compile a harness of `tests/support/avr`, such as "display"; return its program."""
    program = folder / name
    sources = [str(HARNESS / "chip.c"), str(HARNESS / f"{name}.c")]
    compile_or_fail(folder, "gcc", "-O2", *WARNINGS, *sources, "-o", str(program), *LIBRARIES)
    return program


class Display:
    """The display's board at a finger, and its host; time passes only in `run`.

    Attributes
    ----------
    states, others
        States, and answers and greetings, in the order of their arrival.
    spoilt
        Number of frames that the host cannot read.
    """

    def __init__(self, process: "subprocess.Popen[str]", line: socket.socket) -> None:
        self._process = process
        self._line = line
        self._reader = board_reader()
        self._sequence = 0
        self.states: list[BoardState] = []
        self.others: list[CommandAnswer | BoardGreeting] = []
        self.spoilt = 0

    def harness(self, command: str) -> None:
        """Give the harness a line."""
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()

    def report(self) -> dict[str, Any]:
        """Return the harness's report."""
        self.harness("report")
        assert self._process.stdout is not None
        report: dict[str, Any] = json.loads(self._process.stdout.readline())
        return report

    def pass_time(self, ms: float) -> None:
        """Let time pass, without a look at the line."""
        assert self._process.stdout is not None
        self.harness(f"run {ms}")
        assert self._process.stdout.readline() == "ran\n"

    def run(self, ms: float) -> BoardState:
        """Let time pass; return the last state."""
        while ms > 0:
            # A socket holds some 200 frames.
            self.pass_time(min(ms, 100))
            ms -= 100
            self._receive()
        return self.states[-1]

    def run_until(self, mode: BoardMode, most_ms: int = 5_000) -> BoardState:
        """Let time pass until the board is in a state."""
        for _ in range(most_ms):
            if self.run(1).mode is mode:
                return self.states[-1]
        raise AssertionError(f"not in state {mode.name} but {self.states[-1]}")

    def send(self, command: Format, *fields: int) -> int:
        """Send a command; return its sequence number."""
        self._sequence = (self._sequence + 1) % SEQUENCE_TURN
        self.write(encode_command(command, self._sequence, fields))
        return self._sequence

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._line.sendall(data)

    def ask(self, command: Format, *fields: int) -> tuple[CommandResult, int]:
        """Send a command, and return the answer's result and field."""
        sequence, known = self.send(command, *fields), len(self.others)
        self.run(5)
        (answer,) = self.others[known:]
        assert isinstance(answer, CommandAnswer)
        assert answer[:2] == (sequence, command)
        return answer.result, answer.field

    def greet(self) -> BoardGreeting:
        """Return the answer to a greeting."""
        sequence = self.send(Format.GREET)
        self.run(5)
        greeting = self.others[-1]
        assert isinstance(greeting, BoardGreeting)
        assert greeting.sequence == sequence
        return greeting

    def drive(self, steps_per_s: float, ms: int, validity_ms: int = 20) -> BoardState:
        """Send a velocity each 2 ms for a time."""
        for _ in range(0, ms, 2):
            self.send(Format.VELOCITY, round(steps_per_s * 256), validity_ms)
            self.run(2)
        return self.states[-1]

    def _receive(self) -> None:
        try:
            data = self._line.recv(1 << 20)
        except BlockingIOError:
            return
        altered = self._reader.altered
        for report in map(decode_report, self._reader.feed(data)):
            match report:
                case BoardState():
                    self.states.append(report)
                case None:
                    self.spoilt += 1
                case _:
                    self.others.append(report)
        self.spoilt += self._reader.altered - altered


@contextmanager
def running(program: Path, firmware: Path, *settings: str) -> Iterator[Display]:
    """Run the display's board, time on command."""
    ours, its = socket.socketpair()
    ours.setblocking(False)
    command = [str(program), str(firmware), "clock=0", f"socket={its.fileno()}", *settings]
    pipe = subprocess.PIPE
    with (
        ours,
        subprocess.Popen(
            command, stdin=pipe, stdout=pipe, encoding="utf-8", pass_fds=[its.fileno()]
        ) as process,
    ):
        its.close()
        try:
            yield Display(process, ours)
        finally:
            process.kill()
