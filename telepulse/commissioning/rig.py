"""The bench that a press drives, tick by tick: the scene's models, or its drive and film.

A rig's output is a speed in m/s, positive into the finger; for the paper's second-order model a
voltage in V.
"""

import time
from collections import Counter

import numpy as np

from display_node.plant.film import FilmModel
from display_node.plant.scene import ForceModel
from display_node.plant.stepper import Stepper
from display_node.scene import DisplayScene
from protocol.config.quantities import count_text
from protocol.errors import BenchError, DriveError
from protocol.host.realtime import Pacer
from pulse_drives.drive import PERIOD_S, Drive
from pulse_drives.scene import DriveScene
from pulse_sensors.samples import SampleBlock
from pulse_sensors.sensor import Sensor
from telepulse.commissioning.sensor_check import Check, SensorRecord, grade, of_each_force

POLL_S = 2e-4
ANSWER_SPEED_M_PER_S = 1e-3
ANSWERS = 20
ANSWER_WITHIN_S = 0.2
# Time from a command to the report of its speed: with later reports, only the film shows a motion
# in time.
ANSWER_WARN_S, ANSWER_FAIL_S = 0.03, 0.1

FilmSample = tuple[float, float]
"""Time in s and force in N of a reading of the film under the finger."""


class ModelRig:
    """The scene's actuator and film as models; time is counted in ticks."""

    def __init__(self, scene: DisplayScene) -> None:
        self.tick_s = scene.tick_ns * 1e-9
        self._film = FilmModel(scene.film, self.tick_s)
        self._actuator: Stepper | ForceModel
        if (stepper := scene.actuator.stepper) is None:
            self._actuator = scene.actuator.build(self.tick_s)
        else:
            law = stepper.contact(scene.layer.layer())
            self._actuator = Stepper(stepper, law, scene.safety.force_limit_n, self.tick_s)
        self._ticks = 0

    def tick(self, output: float) -> tuple[float, list[FilmSample]]:
        """Hold an output for one tick; return its time in s and the readings until its end."""
        self._actuator.step(output)
        commanded_s = self._ticks * self.tick_s
        self._ticks += 1
        reading_n = self._film.read(self._actuator.force_n)
        return commanded_s, [(self._ticks * self.tick_s, reading_n)]

    def withdraw(self) -> None:
        """Do nothing: a model presses nobody."""


class HardwareRig:
    """The real bench; the caller opens and closes drive and sensor."""

    def __init__(self, drive: Drive, film: Sensor, tick_s: float) -> None:
        self.tick_s = tick_s
        self._drive = drive
        self._film = film
        self._began_ns = time.perf_counter_ns()
        self._pacer = Pacer(round(tick_s * 1e9), self._began_ns)
        film.poll()

    def tick(self, output: float) -> tuple[float, list[FilmSample]]:
        """Hold an output for one tick; return its time in s and the readings until its end.

        It is held, and recorded, for longer where a tick is late. Raises DriveError when the drive
        has failed.
        """
        commanded_ns = time.perf_counter_ns()
        self._drive.command(output)
        while self._pacer.begin(now_ns := time.perf_counter_ns()) is None:
            time.sleep((self._pacer.due_ns - now_ns) * 1e-9)
        fault = self._drive.status().fault
        if fault is not None:
            raise DriveError(fault.kind, f"the drive stopped: {fault}")
        samples = [
            ((taken_ns - self._began_ns) * 1e-9, force_n)
            for reading in self._film.poll()
            for taken_ns, force_n in zip(reading.times_ns, reading.force_n, strict=True)
        ]
        return (commanded_ns - self._began_ns) * 1e-9, samples

    def withdraw(self) -> None:
        """Go back off the finger and rest; afterwards the drive follows no further commands.

        Raises DriveError for a tip that may still press.
        """
        self._drive.withdraw()
        if (fault := self._drive.await_withdrawal()) is not None:
            raise DriveError(fault.kind, f"{fault}: {fault.remedy}")


Rig = ModelRig | HardwareRig


def listen(sensor: Sensor, seconds: float) -> dict[str, SensorRecord]:
    """Record a sensor for `seconds`; return a record of each channel of force, by its name.

    Raises BenchError when no sample comes.
    """
    sensor.poll()
    end_s = time.monotonic() + seconds
    arrivals_ns: list[int] = []
    readings: list[SampleBlock] = []
    while time.monotonic() < end_s:
        time.sleep(POLL_S)
        for reading in sensor.poll():
            arrivals_ns.append(time.perf_counter_ns())
            readings.append(reading)
    if not readings:
        raise BenchError(
            f"no sample came from the sensor in {seconds:g} s: " + "; ".join(sensor.faults())
        )
    values = np.concatenate([reading.values for reading in readings])
    record = SensorRecord(
        taken_ns=np.array([t for reading in readings for t in reading.times_ns], np.int64),
        force_n=values[:, 0],
        arrival_ns=np.array(arrivals_ns, np.int64),
        batch_sizes=np.array([len(reading.values) for reading in readings], np.int64),
        missing=sum(reading.missing for reading in readings),
    )
    return of_each_force(record, values, sensor.channels)


def check_line(scene: DriveScene, tick_s: float) -> Check:
    """Check that the line can carry one command per tick, or at least one per `period`."""
    busy_s, period_s = scene.exchange_s, scene.period_ns * 1e-9
    if busy_s is None:
        return Check("line", f"not known for a drive of kind {scene.kind}")
    found = f"{busy_s * 1e3:.2f} ms each: at most {1 / busy_s:.0f} commands a second"
    reason = f"slower than the loop's {1 / tick_s:.0f} Hz: only the newest command is sent"
    if busy_s > period_s:
        reason = (
            f"the drive's period is {period_s * 1e3:g} ms: use a faster line, or a longer period"
        )
    return grade("line", found, busy_s, tick_s, period_s, reason)


# Errors of the line that the next message corrected, by the drive's names for them.
LINE_ERRORS = {
    "no answer": ("request", "without an answer"),
    "garbled": ("answer", "with a wrong checksum"),
    "wrong": ("answer", "to another request"),
    "missed": ("state", "of the board that did not come"),
    "unread": ("command", "that the board could not read"),
    "malformed": ("message", "of process data with a wrong length"),
    "implausible": ("message", "of process data with values that no drive has"),
}
LINE_ADVICE = "check the line's cable, its rate and this machine's load"


def judge_line_errors(counts: Counter[str]) -> list[Check]:
    """Return a warning for each kind of error on the line to the drive."""
    # Superseded commands are normal on a line that is slower than the loop.
    checks = []
    for name, count in sorted(counts.items()):
        if count > 0 and name != "superseded":
            noun, of = LINE_ERRORS.get(name, ("time", name))
            text = f"{count_text(count, noun)} {of}"
            checks.append(Check("line errors", text, "warn", LINE_ADVICE))
    return checks


def check_answers(drive: Drive) -> Check:
    """Check the time from a command to the drive's report of that speed, away and back."""
    directions = (-1, 0, 1, 0) * (ANSWERS // 4)
    waits_s = [_answer_s(drive, each * ANSWER_SPEED_M_PER_S) for each in directions]
    p50_s, p99_s = np.quantile(waits_s, (0.5, 0.99))
    return grade(
        "drive's answer",
        f"speed reported {p50_s * 1e3:.1f} ms after its command (p50), {p99_s * 1e3:.1f} ms (p99)",
        float(p99_s),
        ANSWER_WARN_S,
        ANSWER_FAIL_S,
        "check the line's rate, its errors and this machine's load",
    )


def _answer_s(drive: Drive, speed_m_per_s: float) -> float:
    """Return the time in s until the drive reports the commanded speed, at most the limit.

    Commands are sent at a bench's interval: more of them than its line takes would be lost.
    """
    began_s = due_s = time.monotonic()
    while (waited_s := time.monotonic() - began_s) < ANSWER_WITHIN_S:
        if time.monotonic() >= due_s:
            drive.command(speed_m_per_s)
            due_s += PERIOD_S
        time.sleep(POLL_S)
        status = drive.status()
        if status.fault is not None:
            raise DriveError(status.fault.kind, f"the drive stopped: {status.fault}")
        reported, half = status.speed_m_per_s, ANSWER_SPEED_M_PER_S / 2
        if abs(reported) < half if not speed_m_per_s else reported * speed_m_per_s > 2 * half**2:
            return waited_s
    return ANSWER_WITHIN_S
