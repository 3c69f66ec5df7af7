"""The finger's board by its own firmware: the sketch on a simulated ATmega328P (simavr).

Sketch and harness are compiled from `firmware/` of a copy of the repository. The harness is the
chip at a motor, a screw, rubber and a fingertip; `firmware/simavr/display.c` has its settings, the
lines that it obeys and its report.
"""

import json
import os
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple, Self

from display_node.scene import ContactorScene
from protocol.errors import ProcessError
from pulse_sensors.drive_film import DriveFilmScene

FIRMWARE = Path(__file__).parents[2] / "firmware"
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
# Above the nodes, since the chip's time counts.
NICEST = -20
# Of the harness's motor.
STEPS_PER_TURN = 200 * 16
# Of a reading, the sum of 16 conversions of 10 bits, each of which rounds down.
COUNTS_PER_V = 16 * 1024 / 5
ROUNDED_COUNTS = 16 / 2
# How the harness's pins are wired, as keys of [display.drive].
WIRED = {"inverted": False, "home_switch": "normally_open", "fault_pin": "none"}


def missing() -> str | None:
    """Return what is missing to run a sketch on a simulated chip; None where nothing is."""
    found = {
        "the folder firmware/ of a copy of the repository": (FIRMWARE / "simavr").is_dir(),
        "a C compiler (gcc)": shutil.which("gcc"),
        "avr-gcc (Debian's gcc-avr)": shutil.which("avr-g++"),
        "Arduino's core (arduino-core-avr)": ARDUINO.is_dir(),
        "simavr (libsimavr-dev)": (INCLUDE / "simavr" / "sim_avr.h").is_file(),
        "libelf (libelf-dev)": (INCLUDE / "libelf.h").is_file(),
    }
    return ", ".join(name for name, is_there in found.items() if not is_there) or None


def run_compiler(folder: Path, *command: str) -> None:
    """Run a compiler in a folder. Raises ProcessError with its complaint."""
    made = subprocess.run(command, cwd=folder, capture_output=True, encoding="utf-8", check=False)
    if made.returncode:
        raise ProcessError(f"{command[0]} failed: {made.stderr.strip()}")


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
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, self._process.pid, NICEST)
            # A priority counts within a session; this is that of the session.
            Path(f"/proc/{self._process.pid}/autogroup").write_text(f"{NICEST}", "utf-8")
        link.symlink_to(self.read_line())

    def close(self) -> None:
        """End the harness, by the end of its input, if it runs."""
        if self._process.returncode is None:
            self._process.communicate()


def settings_of(scene: ContactorScene) -> list[str]:
    """Return the harness's settings for a scene's drive, motor, rubber and film."""
    drive, stepper, film = scene.drive, scene.actuator.stepper, scene.feedback
    # A scene with a drive has a stepper.
    assert drive is not None
    assert stepper is not None
    law = stepper.contact(scene.layer.layer())
    values = {
        "lead_mm": stepper.step_m * STEPS_PER_TURN * 1e3,
        "touch_mm": drive.touch_m * 1e3,
        "start_mm": drive.touch_m * -0.5e3,
        "hertz": (law.position(1.0) - law.finger_m_per_n) ** -1.5,
        "finger_n_per_m": 1 / law.finger_m_per_n,
    }
    if isinstance(film, DriveFilmScene):
        per_count_n = film.newtons_per_count or 1.0
        zero = film.zero - film.preload_n / per_count_n
        values["film_zero_v"] = (zero + ROUNDED_COUNTS) / COUNTS_PER_V
        values["film_v_per_n"] = 1 / per_count_n / COUNTS_PER_V
    return [f"{name}={value!r}" for name, value in values.items()]
