"""The run of an emulated drive and of the film under its finger."""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Protocol

from protocol.errors import OutputError
from protocol.host.process import freeze_objects, stop_on_signals
from sensing_node.sources.wrist import WristSensors
from telepulse.emulators import LATE_MS, PtyPort
from telepulse.emulators.motor import MotorFault, MotorState
from telepulse.emulators.sensor_board import PULSES, binary
from telepulse.emulators.wrist import read_wrist

logger = logging.getLogger(__name__)

FRAME = 4
TRACE_HEADER = "time_ns,tip_m,speed_m_per_s,force_n,trouble\n"
FILM_SILENT = "film-silent"
# The tip presses from this force on; at first touch the force is smaller.
PRESSING_N = 0.01
MOTOR_FAULTS: dict[str, MotorFault] = {
    "overtemperature": "overtemperature",
    "following-error": "following error",
}


class Motor(Protocol):
    """An emulated motor, or a board with its motor.

    forces_n: forces under the tip, one per millisecond, until a reader takes them. trace: called
    with the state every millisecond.
    """

    forces_n: deque[float]
    trace: Callable[[MotorState], None] | None

    @property
    def force_n(self) -> float:
        """Force under the tip."""

    def fail(self, fault: MotorFault) -> None:
        """Begin a fault."""


class EmulatedFilm:
    """Film that sends the finger's force in float32 newtons at 1 kHz, four samples in a frame.

    wrist: film and load cell of a wrist under a probe, in place of the one force of a finger.
    """

    def __init__(self, motor: Motor, port: PtyPort, wrist: WristSensors | None = None) -> None:
        self._motor, self._port, self._wrist = motor, port, wrist
        self._encode = binary("float32", PULSES if wrist is None else WristSensors.channels)
        self._sent = 0

    def deliver(self) -> None:
        """Send the motor's forces since the last call."""
        forces_n = self._motor.forces_n
        while len(forces_n) >= FRAME:
            forces = [forces_n.popleft() for _ in range(FRAME)]
            one = [[force_n] for force_n in forces]
            values = one if self._wrist is None else read_wrist(self._wrist, forces)
            self._sent += FRAME
            self._port.write(self._encode(values, (self._sent - 1) * 1_000))


class DriveRun:
    """The run of an emulated drive with its film on `film_link`, one fault, and a trace.

    Files and ports are closed by `resources`. Raises OutputError.
    """

    def __init__(
        self,
        motor: Motor,
        film_link: Path | None,
        trace: Path | None,
        resources: ExitStack,
        wrist: WristSensors | None = None,
    ) -> None:
        # Before the caller says that the drive runs: who reads that may end it at once.
        self._stopped = threading.Event()
        stop_on_signals(self._stopped.set)
        self._motor = motor
        self._film: EmulatedFilm | None = None
        self._active_fault = ""
        if film_link is not None:
            port = PtyPort(film_link)
            resources.callback(port.close)
            self._film = EmulatedFilm(motor, port, wrist)
        if trace is not None:
            try:
                file = resources.enter_context(trace.open("w", encoding="utf-8"))
            except OSError as error:
                raise OutputError(f"{trace}: cannot be written: {error.strerror}") from None
            file.write(TRACE_HEADER)

            def write(state: MotorState) -> None:
                time_ns, *values = state
                numbers = ",".join(f"{value:.9f}" for value in values)
                file.write(f"{time_ns},{numbers},{self._active_fault}\n")

            motor.trace = write

    def run(
        self,
        poll: Callable[[], None],
        begin_fault: Callable[[str], None],
        fault: str | None,
        after_s: float | None,
        seconds: float | None,
    ) -> None:
        """Poll the drive until stopped, or for `seconds`, and begin the fault named `fault`.

        begin_fault: begins a fault of the bus or serial line, by name. after_s: time from the tip's
        first press to the fault; None: the fault begins at the start.
        """
        freeze_objects()
        began_s = last_s = time.monotonic()
        pressed_s, longest_s = math.inf, LATE_MS * 1e-3
        while not self._stopped.is_set():
            now_s = time.monotonic()
            if now_s - last_s > longest_s:
                longest_s = now_s - last_s
                logger.warning(
                    f"this machine kept the emulated drive waiting for {longest_s * 1e3:.0f} ms:"
                    " a fault may come from that and not from a drive; end other programs"
                )
            last_s = now_s
            if self._motor.force_n > PRESSING_N:
                pressed_s = min(pressed_s, now_s)
            due = after_s is None or now_s - pressed_s >= after_s
            if fault and not self._active_fault and due:
                self._active_fault = fault
                if fault in MOTOR_FAULTS:
                    self._motor.fail(MOTOR_FAULTS[fault])
                elif fault != FILM_SILENT:
                    begin_fault(fault)
            poll()
            if self._film is None or self._active_fault == FILM_SILENT:
                self._motor.forces_n.clear()
            else:
                self._film.deliver()
            if seconds is not None and now_s - began_s >= seconds:
                return
