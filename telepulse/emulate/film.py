"""The film under an emulated drive's finger, as a sensor board on a port of its own."""

from telepulse.emulate.motor import TICK_NS, EmulatedMotor
from telepulse.emulate.pty_port import PtyPort
from telepulse.emulate.sensor_board import binary

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
