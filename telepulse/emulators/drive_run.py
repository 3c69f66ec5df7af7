"""An emulated drive while it runs: its motor, the film under its finger, the record of both.

The film under an emulated drive's finger, as a sensor board on a port of its own.
"""

import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TextIO

from protocol.errors import OutputError
from protocol.host.measures import freeze_objects
from protocol.host.process import stop_on_signals
from telepulse.emulators.fault_injection import InjectedFault
from telepulse.emulators.motor import TICK_NS, EmulatedMotor, MotorFault, MotorState
from telepulse.emulators.pty_port import PtyPort
from telepulse.emulators.sensor_board import binary

FRAME = 4


class EmulatedFilm:
    """Sends the force under the finger, in float32 newtons at 1 kHz, four samples a frame."""

    def __init__(self, motor: EmulatedMotor, port: PtyPort) -> None:
        """Raises SourceError without the cobs package."""
        self._motor = motor
        self._port = port
        self._encode = binary("float32")
        self._sent = 0

    def deliver(self) -> None:
        """Send what the motor has gone through since the last call."""
        forces_n = self._motor.forces_n
        late = self._motor.lies.film_late_ns // TICK_NS
        while len(forces_n) >= FRAME + late:
            values = [forces_n.popleft() for _ in range(FRAME)]
            self._sent += FRAME
            self._port.write(self._encode(values, (self._sent - 1) * 1_000))

    def close(self) -> None:
        """Unplug."""
        self._port.close()


TRACE_HEADER = "time_ns,tip_m,speed_m_per_s,force_n,trouble\n"
FILM_SILENT = "film-silent"
# From so much on a tip presses; where it is brought to first touch it may feel a little.
PRESSING_N = 0.01
MOTOR_FAULTS: dict[str, MotorFault] = {
    "overtemperature": "overtemperature",
    "following-error": "following error",
}


class DriveRun:
    """Loop that polls an emulated drive, begins one fault, and records the motor's every
    millisecond."""

    def __init__(
        self,
        motor: EmulatedMotor,
        film_link: Path | None,
        trace: Path | None,
        open_things: ExitStack,
    ) -> None:
        """open_things closes what is opened here. Raises OutputError."""
        self._motor = motor
        self._film: EmulatedFilm | None = None
        self._trouble = ""
        if film_link is not None:
            self._film = EmulatedFilm(motor, PtyPort(film_link))
            open_things.callback(self._film.close)
        if trace is not None:
            self._file = open_things.enter_context(_opened(trace))
            self._file.write(TRACE_HEADER)
            motor.trace = self._write

    def run(
        self,
        poll: Callable[[], None],
        break_down: Callable[[str], None],
        trouble: str | None,
        lie: InjectedFault | None,
        after_s: float | None,
        seconds: float | None,
    ) -> None:
        """Poll until stopped or `seconds` are over.

        trouble: what goes wrong; what is not the motor's, the film's or the `lie` is
        `break_down`'s. after_s: when, from when the tip presses first; None: from the start.
        """
        stopping = False

        def stop() -> None:
            nonlocal stopping
            stopping = True

        stop_on_signals(stop)
        freeze_objects()
        began_s, pressed_s = time.monotonic(), math.inf
        while not stopping:
            now_s = time.monotonic()
            if self._motor.force_n > PRESSING_N:
                pressed_s = min(pressed_s, now_s)
            due = after_s is None or now_s - pressed_s >= after_s
            if trouble and not self._trouble and due:
                self._trouble = trouble
                if lie is not None:
                    self._motor.lies.begin(lie, time.monotonic_ns())
                elif trouble in MOTOR_FAULTS:
                    self._motor.fail(MOTOR_FAULTS[trouble])
                elif trouble != FILM_SILENT:
                    break_down(trouble)
            poll()
            self._deliver()
            if seconds is not None and now_s - began_s >= seconds:
                return

    def _deliver(self) -> None:
        if self._film is None or self._trouble == FILM_SILENT:
            # Nobody reads it.
            self._motor.forces_n.clear()
        else:
            self._film.deliver()

    def _write(self, moment: MotorState) -> None:
        time_ns, tip_m, speed_m_per_s, force_n = moment
        row = f"{time_ns},{tip_m:.9f},{speed_m_per_s:.9f},{force_n:.9f},{self._trouble}\n"
        self._file.write(row)


def _opened(path: Path) -> TextIO:
    try:
        return path.open("w", encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from None
