"""The bench for a class as processes: both nodes, and the finger's sketch on a simulated chip.

The chip runs in real time, with the drive's line on a pseudo-terminal. It records what the finger
feels by its own time, so that a slow host does not make a withdrawal look slow.
"""

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import tomlkit
from numpy.typing import NDArray

from protocol.config.scene_file import find_scene, load_document
from pulse_drives.stepdir.frames import BoardLimits, CommandResult, Format
from telepulse.emulators import LATE_MS
from tests.support.avr_boards import Display
from tests.support.emulated_bench import BenchFailedError, EmulatedBench
from tests.support.simavr import Harness, Programs
from tests.support.waiting import until

# The pulse, made by the sensing node or by the emulator of the wrist's board.
SOURCE = "bench"
PRESSED_N = 0.05
PRESSED_S = 0.1
# Samples that are played until a fault: by then the pulse is felt.
PLAYED = 500
TICK_HZ = 32_000
CONSTANT_MS, STARTING_MS = 600, 50
# 9 600 000 steps/s² are the 6 m/s² of the scene.
STEPPED = BoardLimits(-(10**6), 10**6, 9_600_000, TICK_HZ, 0, 16_369, 3_000, 16_000, 50, 0)
# From a fault to the end of the chip.
AFTER_S = 1.5
GARBAGE_S = 0.3


class BusyMachineError(BenchFailedError):
    """The chip was kept waiting, so that the bench shows nothing."""


class ChipTrace(NamedTuple):
    """The harness's record.

    time_s, tip_um, force_n, motor_on: each ms of the chip's time. step_cycles: edges of the step
    pin, in cycles of 16 MHz.
    """

    time_s: NDArray[np.float64]
    tip_um: NDArray[np.float64]
    force_n: NDArray[np.float64]
    motor_on: NDArray[np.bool_]
    step_cycles: NDArray[np.int64]

    @classmethod
    def read(cls, path: Path) -> "ChipTrace":
        """Read the file of a harness that has ended."""
        rows = [line.split(",") for line in path.read_text("utf-8").splitlines()]
        time_s, tip_um, force_mn, motor_on = np.array(
            [row[1:] for row in rows if row[0] == "ms"], np.float64
        ).T
        steps = np.array([row[1] for row in rows if row[0] == "step"], np.int64)
        return cls(time_s, tip_um, force_mn * 1e-3, motor_on > 0, steps)

    def left_after_s(self, began_s: float) -> float:
        """Return the time from an instant until the tip is off the finger, infinite if it stays.

        Raises BenchFailedError where it did not press before.
        """
        before = (self.time_s > began_s - PRESSED_S) & (self.time_s <= began_s)
        if not before.any() or self.force_n[before].min() < PRESSED_N:
            raise BenchFailedError("the pulse was not felt when the fault came")
        if self.force_n[-1] > 0:
            return float("inf")
        return max(0.0, float(self.time_s[self.force_n > 0][-1]) - began_s)


def given_steps(programs: Programs, rate_hz: float, folder: Path) -> tuple[float, float, int]:
    """Return a rate as given there, the greatest deviation of a step from it in s, and lost steps.

    The motor goes there and back, without nodes and without a finger; time passes on command.
    """
    trace = folder / "steps.csv"
    with closing(Display(programs, f"trace={trace}", "finger_n_per_m=0.001")) as display:
        display.run(10)
        for command in ((Format.LIMITS, *STEPPED), (Format.ARM,), (Format.HOME, 0, 0, 1, 1)):
            assert display.ask(*command) == (CommandResult.DONE, 0)
        display.drive(rate_hz, STARTING_MS)
        began_s = display.report()["time_s"]
        display.drive(rate_hz, CONSTANT_MS)
        ended_s = display.report()["time_s"]
        display.drive(-rate_hz, CONSTANT_MS)
        lost: int = display.report()["lost_steps"]
    times_s = ChipTrace.read(trace).step_cycles / 16e6
    times_s = times_s[(times_s > began_s) & (times_s < ended_s)]
    numbers = np.arange(len(times_s))
    line = np.polyfit(numbers, times_s, 1)
    return 1 / line[0], float(np.abs(times_s - np.polyval(line, numbers)).max()), lost


class ClassBench(EmulatedBench):
    """An `EmulatedBench` whose drive is the sketch on a simulated chip.

    with_board: the emulator of the wrist's board plays the pulse; otherwise the sensing node makes
    it.
    """

    def __init__(self, folder: Path, programs: Programs, with_board: bool) -> None:
        super().__init__(folder, "stepdir", SOURCE)
        self._trace_file = folder / "chip.csv"
        with (folder / "log").open("ab") as log:
            self.chip = Harness(programs, f"trace={self._trace_file}", stderr=log)
        self.chip.open_line(self.film)
        if not with_board:
            tables = load_document(self.scene)
            tables["sensing"]["source"] = load_document(find_scene(SOURCE))["sensing"]["source"]
            self.scene.write_text(tomlkit.dumps(tables), encoding="utf-8")

    def timely_report(self) -> dict[str, Any]:
        """Return a report. Raises BusyMachineError if the chip was kept waiting since the last."""
        report = self.chip.report()
        if (late_ms := report["late_ms"]) > LATE_MS:
            raise BusyMachineError(f"this machine kept the chip waiting for {late_ms:.0f} ms")
        return report

    def spoil_line(self) -> None:
        """Send the board garbage besides the display's commands, for some time."""
        line = os.open(self.film, os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
        until_s = time.monotonic() + GARBAGE_S
        while time.monotonic() < until_s:
            with suppress(BlockingIOError):
                os.write(line, os.urandom(64))
            time.sleep(0.001)
        os.close(line)

    def end_chip(self) -> ChipTrace:
        """End the chip; return its record. Raises BusyMachineError."""
        self.timely_report()
        self.chip.close()
        return ChipTrace.read(self._trace_file)


@contextmanager
def playing(folder: Path, programs: Programs, with_board: bool = False) -> Iterator[ClassBench]:
    """Provide a bench on which the pulse is felt. Raises BenchFailedError."""
    with ExitStack() as leaving:
        bench = ClassBench(folder, programs, with_board)
        leaving.callback(bench.chip.close)
        leaving.callback(bench.kill)
        if with_board:
            bench.start_board()
            until((folder / "board").exists)
        bench.start_sensing()
        bench.start_display()
        try:
            bench.await_state("playing", played=PLAYED)
        except BenchFailedError:
            bench.timely_report()
            raise
        # What delayed the chip while the nodes started does not count.
        bench.chip.report()
        yield bench


Fault = Callable[[ClassBench], object]


def alone(command: str) -> Fault:
    """Return a fault of the harness that the display cannot answer, since it is stopped before."""

    def happens(bench: ClassBench) -> None:
        bench.processes["display"].send_signal(signal.SIGSTOP)
        bench.chip.tell(command)

    return happens


# Faults that the board finds by itself, before its watchdog finds that the display is stopped.
FOUND_AT_ONCE: Final[dict[str, Fault]] = {
    "home switch stuck": alone("switch 1"),
    "film torn off": alone("film 0"),
    "film at full scale": alone("film 5"),
    "reset by DTR": alone("reset"),
}
FAULTS: Final[dict[str, Fault]] = {
    "kill -9 of the display": lambda bench: bench.processes["display"].kill(),
    "SIGSTOP of the display": lambda bench: bench.processes["display"].send_signal(signal.SIGSTOP),
    "cable unplugged": lambda bench: bench.chip.tell("unplug"),
    "garbage on the line": ClassBench.spoil_line,
    **FOUND_AT_ONCE,
}


def left_after_s(programs: Programs, fault: Fault, folder: Path) -> float:
    """Return the chip's time from a fault until the tip is off the finger.

    Raises BenchFailedError where the pulse was not felt before.
    """
    with playing(folder, programs) as bench:
        began_s = bench.chip.report()["time_s"]
        fault(bench)
        time.sleep(AFTER_S)
        return bench.end_chip().left_after_s(began_s)
