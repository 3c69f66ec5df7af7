"""The boards by their own firmware: the sketches on a simulated ATmega328P (simavr).

The harness of the finger's board is the chip at a motor, a screw, rubber and a fingertip;
`firmware/simavr/display.c` has its settings, the lines that it obeys and its report.
"""

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple, Self

from protocol.errors import ProcessError
from telepulse.emulators.sketch import FIRMWARE, run_compiler
from telepulse.processes import prefer

ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr")
INCLUDE = Path("/usr/include")
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
    """Return what is missing to run a sketch on a simulated chip; None where nothing is."""
    found = {
        "a C compiler (gcc)": shutil.which("gcc"),
        "avr-gcc (Debian's gcc-avr)": shutil.which("avr-g++"),
        "Arduino's core (arduino-core-avr)": ARDUINO.is_dir(),
        "simavr (libsimavr-dev)": (INCLUDE / "simavr" / "sim_avr.h").is_file(),
        "libelf (libelf-dev)": (INCLUDE / "libelf.h").is_file(),
    }
    return ", ".join(name for name, is_there in found.items() if not is_there) or None


def compile_sketch(name: str, folder: Path) -> Path:
    """Compile a sketch of `firmware/` with Arduino's core; return its ELF file."""
    core = ARDUINO / "cores" / "arduino"
    chip = [*CHIP.split(), *LTO, f"-I{core}", f"-I{ARDUINO}/variants/standard"]
    cpp = ["avr-g++", *chip, *CPP.split(), "-c"]
    firmware, sketch = folder / f"{name}.elf", FIRMWARE / name / f"{name}.ino"
    objects = [f"{part}.o" for part in (*CORE, *WIRING)]
    wiring = [str(core / f"{part}.c") for part in WIRING]
    run_compiler(folder, "avr-gcc", *chip, "-std=gnu11", "-c", *wiring)
    run_compiler(folder, *cpp, *(str(core / f"{part}.cpp") for part in CORE))
    run_compiler(
        folder, *cpp, *WARNINGS, "-include", "Arduino.h", "-x", "c++", str(sketch), "-o", "sketch.o"
    )
    run_compiler(folder, "avr-gcc-ar", "rcs", "core.a", *objects)
    run_compiler(folder, "avr-g++", *LINK.split(), "sketch.o", "core.a", "-lm", "-o", str(firmware))
    return firmware


def compile_harness(name: str, folder: Path) -> Path:
    """Compile a harness of `firmware/simavr`, such as "display"; return its program."""
    program = folder / name
    sources = [str(FIRMWARE / "simavr" / file) for file in ("chip.c", f"{name}.c")]
    run_compiler(folder, "gcc", "-O2", *WARNINGS, *sources, "-o", str(program), *LIBRARIES)
    return program


class Programs(NamedTuple):
    """The harness of the finger's board, and the sketch."""

    harness: Path
    firmware: Path

    @classmethod
    def compile(cls, folder: Path) -> Self:
        """Compile both in a folder. Raises ProcessError, also where something is missing."""
        if (lacking := missing()) is not None:
            raise ProcessError(f"it lacks {lacking}")
        sketch = compile_sketch("telepulse_display", folder)
        return cls(compile_harness("display", folder), sketch)


class Harness:
    """A running harness.

    settings: its own, such as "clock=0". options: those of `subprocess.Popen`.
    """

    def __init__(self, programs: Programs, *settings: str, **options: Any) -> None:
        pipe = subprocess.PIPE
        # Ctrl-C at a terminal must not end the drive before the display has withdrawn it.
        options |= {"stdin": pipe, "stdout": pipe, "start_new_session": True}
        command = [*map(str, programs), *settings]
        self._process = subprocess.Popen(command, encoding="utf-8", **options)

    def tell(self, command: str) -> None:
        """Give the harness a line, such as "film 5"."""
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()

    def read_line(self) -> str:
        """Return its next line. Raises ProcessError where it has ended."""
        assert self._process.stdout is not None
        line: str = self._process.stdout.readline().rstrip("\n")
        if not line:
            raise ProcessError("the simulated board of the finger has ended")
        return line

    def report(self) -> dict[str, Any]:
        """Return its report. Raises ProcessError where it has ended."""
        self.tell("report")
        report: dict[str, Any] = json.loads(self.read_line())
        return report

    def open_line(self, link: Path) -> None:
        """Link to the pseudo-terminal of a harness in real time. Raises ProcessError."""
        prefer(self._process.pid)
        link.symlink_to(self.read_line())

    def close(self) -> None:
        """End the harness, by the end of its input, if it runs."""
        if self._process.returncode is None:
            self._process.communicate()
