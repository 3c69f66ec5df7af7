"""A bench that can be pressed with, tick by tick: here the scene's models, in virtual time.

The bench itself: its drive and the sensor of its film, in real time.

How many commands a second a drive's line can carry, by its bits.
"""

import time
from typing import NamedTuple, Protocol

import numpy as np

from display_node.drives.drive import Drive
from display_node.drives.hardware import WITHDRAWN_WITHIN_S
from display_node.drives.homing import PERIOD_S
from display_node.drives.scene import Cia402Scene, TmclScene
from display_node.drives.withdrawal import WithdrawalOutcome
from display_node.plant.film import FeedbackFilm
from display_node.plant.second_order import SecondOrder, SecondOrderScene
from display_node.plant.stepper import Stepper, StepperScene
from display_node.scene import DisplayScene
from protocol.errors import BenchError, DriveError
from pulse_sensors.reading import Reading
from pulse_sensors.sensor import Sensor
from telepulse.commissioning.sensor_check import Check, SensorRecord, grade


class FilmSample(NamedTuple):
    """One reading of the film under the finger, and when it was taken."""

    time_s: float
    force_n: float


class Rig(Protocol):
    """An actuator with a film under it.

    It is told a speed in m/s, positive into the finger; the paper's second-order model a
    voltage in V.
    """

    @property
    def tick_s(self) -> float:
        """How long a tick is."""

    def tick(self, output: float) -> tuple[float, list[FilmSample]]:
        """Hold an output for one tick: when it was told, and what the film said until its end."""

    def retreat(self) -> None:
        """Go back the way it came, to where it began, and rest there."""


class ModelRig:
    """The scene's actuator and film as models; time is counted in ticks."""

    def __init__(self, scene: DisplayScene) -> None:
        self.tick_s = scene.tick_ns * 1e-9
        self._film = FeedbackFilm(scene.film, self.tick_s)
        self._actuator: Stepper | SecondOrder
        if isinstance(scene.actuator, SecondOrderScene):
            self._actuator = SecondOrder(scene.actuator, self.tick_s)
        else:
            self._actuator = _stepper(scene, scene.actuator, self.tick_s)
            self._vco = scene.actuator.step_rate()
        self._ticks = 0

    def tick(self, output: float) -> tuple[float, list[FilmSample]]:
        """See `Rig.tick`."""
        if isinstance(self._actuator, SecondOrder):
            self._actuator.step(output)
        else:
            self._actuator.step(self._vco.rate_hz(output))
        told_s = self._ticks * self.tick_s
        self._ticks += 1
        reading_n = self._film.read(self._actuator.force_n)
        return told_s, [FilmSample(self._ticks * self.tick_s, reading_n)]

    def retreat(self) -> None:
        """See `Rig.retreat`; nothing is pressed by a model."""


def _stepper(scene: DisplayScene, actuator: StepperScene, tick_s: float) -> Stepper:
    law = actuator.contact(scene.layer.layer())
    return Stepper(actuator, law, scene.safety.force_limit_n, tick_s)


# A TMCL datagram has 9 bytes, each with a start and a stop bit; every request has its reply.
TMCL_BITS = 9 * 10
TMCL_CAN_BYTES = 7
# One cycle: RPDO (control word, target velocity), SYNC, TPDOs (status, mode and position; speed
# and error code).
CIA402_BYTES = (6, 0, 7, 6)


def can_frame_bits(data_bytes: int) -> int:
    """Bits of a CAN frame with an 11-bit identifier at worst: 47 of its own with the pause after
    it, its data, and a stuffed bit after every 4 of those that are stuffed (ISO 11898-1)."""
    return 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4


def exchange_s(scene: TmclScene | Cia402Scene) -> float:
    """How long one command and what answers it keep the line busy."""
    if isinstance(scene, Cia402Scene):
        return sum(map(can_frame_bits, CIA402_BYTES)) / scene.bitrate_bit_per_s
    if scene.port is None:
        return 2 * can_frame_bits(TMCL_CAN_BYTES) / scene.bitrate_bit_per_s
    return 2 * TMCL_BITS / scene.baud


def check_line(scene: TmclScene | Cia402Scene, tick_s: float) -> Check:
    """Whether the line can carry a command a tick, or at least one a `period`."""
    busy_s = exchange_s(scene)
    found = f"{busy_s * 1e3:.2f} ms each: at most {1 / busy_s:.0f} commands a second"
    if busy_s > scene.period_ns * 1e-9:
        period = f"{scene.period_ns * 1e-6:g} ms"
        reason = f"the drive's period is {period}: a faster line, or a longer period"
        return Check("line", found, "fail", reason)
    if busy_s > tick_s:
        reason = f"slower than the loop's {1 / tick_s:.0f} Hz: between them the newest command wins"
        return Check("line", found, "look", reason)
    return Check("line", found)


POLL_S = 2e-4
ANSWER_SPEED_M_PER_S = 1e-3
ANSWERS = 20
ANSWER_WITHIN_S = 0.2
# A drive that says so late what it does is no use to a loop that hears of it by the film alone.
ANSWER_LOOK_S, ANSWER_FAIL_S = 0.03, 0.1


class HardwareRig:
    """See `Rig`. Drive and sensor are open already; whoever opened them closes them.

    Raises DriveError when the drive has failed.
    """

    def __init__(self, drive: Drive, film: Sensor, tick_s: float) -> None:
        self.tick_s = tick_s
        self._drive = drive
        self._film = film
        self._began_ns = self._due_ns = time.monotonic_ns()
        self._began_m = drive.way_m(self._began_ns)
        film.poll()

    def tick(self, output: float) -> tuple[float, list[FilmSample]]:
        """See `Rig.tick`; a tick that comes late is held for longer, and recorded so."""
        told_ns = time.monotonic_ns()
        self._drive.command(output)
        # Never faster than a tick: what was missed is not made up for.
        self._due_ns = max(self._due_ns + round(self.tick_s * 1e9), told_ns)
        time.sleep(max(0.0, (self._due_ns - time.monotonic_ns()) * 1e-9))
        fault = self._drive.status().fault
        if fault is not None:
            raise DriveError("fault", f"the drive stopped: {fault}")
        samples = [
            FilmSample((taken_ns - self._began_ns) * 1e-9, force_n)
            for reading in self._film.poll()
            for taken_ns, force_n in zip(reading.times_ns, reading.force_n, strict=True)
        ]
        return (told_ns - self._began_ns) * 1e-9, samples

    def retreat(self) -> None:
        """See `Rig.retreat`: off the finger, which ends the drive's following of commands."""
        drive = self._drive
        drive.withdraw("stopped")
        end_s = time.monotonic() + WITHDRAWN_WITHIN_S
        while drive.status().withdrawal is WithdrawalOutcome.UNDER_WAY and time.monotonic() < end_s:
            time.sleep(PERIOD_S)


def listen(sensor: Sensor, seconds: float) -> SensorRecord:
    """Read a sensor for so long. Raises BenchError when no sample comes."""
    sensor.poll()
    end_s = time.monotonic() + seconds
    arrivals_ns: list[int] = []
    readings: list[Reading] = []
    while time.monotonic() < end_s:
        time.sleep(POLL_S)
        for reading in sensor.poll():
            arrivals_ns.append(time.monotonic_ns())
            readings.append(reading)
    if not readings:
        raise BenchError(f"no sample came in {seconds:g} s: " + "; ".join(sensor.faults()))
    return SensorRecord(
        taken_ns=np.array([t for reading in readings for t in reading.times_ns], np.int64),
        force_n=np.array([f for reading in readings for f in reading.force_n]),
        arrival_ns=np.array(arrivals_ns, np.int64),
        arrived=np.array([len(reading.force_n) for reading in readings], np.int64),
        missing=sum(reading.missing for reading in readings),
    )


def check_answers(drive: Drive) -> Check:
    """Check the time from a command to the drive's own report of that speed: off the finger and
    back."""
    waits_s = []
    for _ in range(ANSWERS // 4):
        for speed_m_per_s in (-ANSWER_SPEED_M_PER_S, 0.0, ANSWER_SPEED_M_PER_S, 0.0):
            waits_s.append(_answer_s(drive, speed_m_per_s))
    p50_s, p99_s = np.quantile(waits_s, (0.5, 0.99))
    return grade(
        "drive's answer",
        f"speed reported {p50_s * 1e3:.1f} ms after its command (p50), {p99_s * 1e3:.1f} ms (p99)",
        float(p99_s),
        ANSWER_LOOK_S,
        ANSWER_FAIL_S,
        "look at the line's rate, its errors and this machine's load",
    )


def _answer_s(drive: Drive, speed_m_per_s: float) -> float:
    """Return the time in s until the drive reports the commanded speed; the limit where it does
    not."""
    began_s = time.monotonic()
    while (waited_s := time.monotonic() - began_s) < ANSWER_WITHIN_S:
        drive.command(speed_m_per_s)
        time.sleep(POLL_S)
        status = drive.status()
        if status.fault is not None:
            raise DriveError("fault", f"the drive stopped: {status.fault}")
        reported, half = status.speed_m_per_s, ANSWER_SPEED_M_PER_S / 2
        if abs(reported) < half if not speed_m_per_s else reported * speed_m_per_s > 2 * half**2:
            return waited_s
    return ANSWER_WITHIN_S
