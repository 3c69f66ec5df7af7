"""The real bench of a display node: the drive that is commanded and the film that is read."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from display_node.display import Display, TickState
from display_node.drives import Drive, build_drive
from display_node.drives.withdrawal import FingerState, WithdrawalOutcome
from display_node.fault_advice import advised
from display_node.plant.feedback import Feedback, FilmPlausibility, RisingForce
from display_node.plant.stepper import StepperScene
from display_node.scene import DisplayScene
from protocol.errors import SceneError, SourceError
from protocol.limits import LimitCounter
from pulse_sensors.scene import open_sensor
from pulse_sensors.sensor import Sensor

FIRST_SAMPLE_WITHIN_S = 5.0
POLL_S = 0.01
# The longest withdrawal: a stroke that nothing confirms, at the slow speed.
WITHDRAWN_WITHIN_S = 1.5


@contextmanager
def connected(
    scene: DisplayScene, folder: Path, log: Callable[[str], None], without_film: bool = False
) -> Iterator["Hardware | None"]:
    """The bench of a scene, started, within a `with`; None for a scene that names no drive.

    `folder` is the scene file's. without_film: a drive may press a finger with no film under it.
    Raises SceneError, SourceError and DriveError.
    """
    if scene.drive is None:
        yield None
        return
    if scene.feedback is None and not without_film:
        raise SceneError(
            "[display.feedback] is missing: without a film nothing measures the force, and a drive"
            " that turns further than it counts is not noticed; add the film, or give"
            " --without-film where no person's finger is pressed"
        )
    layer, force_limit_n = scene.layer.layer(), scene.safety.force_limit_n
    drive = build_drive(scene.drive, scene.actuator, layer, force_limit_n)
    sensor = open_sensor(scene.feedback, folder, log) if scene.feedback is not None else None
    with closing(Hardware(scene, drive, sensor)) as hardware:
        log("the drive looks for its home: keep the finger away")
        with advised():
            hardware.start()
        log("the drive is at first touch")
        yield hardware


class Hardware:
    """A drive, and the sensor of the feedback film.

    Without a sensor the film is told by the model of contact, from where the drive says it is.
    feedback: what the display reads. at_end: ticks in which the drive was slowed before the far end
    of its travel.
    """

    def __init__(self, scene: DisplayScene, drive: Drive, sensor: Sensor | None) -> None:
        """drive and sensor are closed by `close`. Raises SceneError for a scene that names no
        drive, or one of no stepper."""
        actuator = scene.actuator
        if scene.drive is None or not isinstance(actuator, StepperScene):
            raise SceneError('[display] drive: it needs an actuator of kind "stepper"')
        self._contact = actuator.contact(scene.layer.layer())
        self._plausibility = FilmPlausibility(actuator, scene.layer.layer())
        safety = scene.safety
        self._rising = RisingForce(
            safety.force_limit_n * safety.overforce,
            safety.slew_limit_n_per_s,
            scene.film.latency_ns,
        )
        self._film_fault: str | None = None
        self._drive = drive
        self._sensor = sensor
        # The drive's, when it was read last.
        self._status = drive.status()
        self._heard_ns = 0
        self.at_end = LimitCounter()
        self._began_ns = time.monotonic_ns()
        # Where the drive's commands had led to at the last tick.
        self._way_m: float | None = None
        self._tick_ns = scene.tick_ns
        self._watchdog_ns = scene.drive.watchdog_ns
        self.feedback = Feedback(scene.film.latency_ns, scene.safety.feedback_within_ns)

    def start(self) -> None:
        """Wait for the film's first sample, then bring the drive to first touch; blocks.

        Raises DriveError, and SourceError when no sample comes: then the drive has not moved.
        """
        if self._sensor is not None:
            self._await_film(self._sensor)
        self._drive.start(self._film_n)
        # What touched the film until now was no press of ours.
        self._film_fault = None
        self.read()

    def read(self) -> str | None:
        """Hand what has come to `feedback` and drive; the fault, if there is one."""
        newest = self._read_film(self._sensor) if self._sensor is not None else None
        # After the film, which a withdrawal goes by.
        self._status = status = self._drive.status()
        if self._sensor is None:
            if status.heard_ns != self._heard_ns:
                self._heard_ns = status.heard_ns
                self.feedback.hear(status.heard_ns, self._contact.force(status.position_m))
        else:
            self._plausibility.report(status.position_m, status.heard_ns)
            if newest is not None and status.fault is None:
                contradiction = self._plausibility.contradiction(newest[1], newest[0])
                return self._film_fault or contradiction
        return None if status.fault is None else f"drive: {status.fault}"

    def tick(self, display: Display, now_ns: int, elapsed_ticks: int) -> TickState:
        """Tick a display on this bench, and command the drive: the controller's output, or after a
        fault the withdrawal."""
        safety = display.safety
        fault = self.read()
        if fault is not None and not safety.faults:
            safety.fault(fault)
        silent_ns = elapsed_ticks * self._tick_ns
        if silent_ns > self._watchdog_ns and not safety.faults:
            # The drive has come to rest by itself, somewhere.
            safety.fault(f"loop overrun: no command for {silent_ns * 1e-6:.0f} ms")
        way_m = self._drive.way_m(now_ns)
        if self._way_m is not None:
            # Told late or not at all, a change of speed leaves the tip elsewhere than was meant.
            display.shift(way_m - self._way_m - display.output * silent_ns * 1e-9)
        self._way_m = way_m
        felt = display.tick(now_ns, elapsed_ticks)
        # A drive at fault takes no command: what it did with the last one is of the past.
        self.at_end.add(self._status.held_back and not safety.faults)
        if safety.faults:
            self._drive.withdraw(safety.faults[0])
            self._name_withdrawal(display)
        else:
            self._drive.command(display.output)
        return felt

    def finger(self, now_ns: int) -> FingerState:
        """Return what is measured at the finger now."""
        self.read()
        status, newest = self._status, self.feedback.newest
        since_ns = self._began_ns if newest is None else newest[0]
        known = newest is not None and self.feedback.alive(now_ns)
        blind = self._sensor is None and status.withdrawal in (
            WithdrawalOutcome.UNCONFIRMED,
            WithdrawalOutcome.WRONG_WAY,
        )
        return FingerState(
            force_n=newest[1] if newest is not None and known and not blind else None,
            unknown_s=(now_ns - since_ns) * 1e-9,
            measured_by="" if self._sensor is not None else "by the drive's position",
            outcome=status.withdrawal,
            answers=now_ns - status.answered_ns <= self._watchdog_ns,
        )

    def _await_film(self, sensor: Sensor) -> None:
        deadline_s = time.monotonic() + FIRST_SAMPLE_WITHIN_S
        while self._read_film(sensor) is None:
            if time.monotonic() > deadline_s:
                raise SourceError(
                    f"[display.feedback] no sample within {FIRST_SAMPLE_WITHIN_S:g} s:"
                    " is the film's sensor the right one, and on?"
                )
            time.sleep(POLL_S)

    def _film_n(self) -> float | None:
        """The newest reading of the film; None without one."""
        if self._sensor is None:
            return None
        self._read_film(self._sensor)
        newest = self.feedback.newest
        return None if newest is None else newest[1]

    def _read_film(self, sensor: Sensor) -> tuple[int, float] | None:
        """Pass on what the film's sensor has sent; its newest sample, None where none came."""
        samples = self.feedback.samples
        for reading in sensor.poll():
            for taken_ns, force_n in zip(reading.times_ns, reading.force_n, strict=True):
                self.feedback.hear(taken_ns, force_n)
                self._film_fault = self._film_fault or self._rising.fault(force_n, taken_ns)
        newest = self.feedback.newest
        if newest is None or self.feedback.samples == samples:
            return None
        self._drive.press(newest[1], newest[0])
        return newest

    def _name_withdrawal(self, display: Display) -> None:
        outcome = self._status.withdrawal
        if outcome in (WithdrawalOutcome.UNCONFIRMED, WithdrawalOutcome.WRONG_WAY):
            display.safety.fault(f"withdrawal: {outcome.value}")

    @property
    def measures_force(self) -> bool:
        """True where a film measures the force; without, the model of contact stands for it."""
        return self._sensor is not None

    @property
    def counts(self) -> Counter[str]:
        """Errors on the way to drive and film that were made good, by name."""
        counts = Counter({f"drive {name}": n for name, n in self._drive.counts.items()})
        if self._sensor is not None:
            counts.update({f"film {name}": n for name, n in self._sensor.rejected.items()})
        counts["film out of order"] = self.feedback.out_of_order
        return +counts

    def faults(self) -> list[str]:
        """Return what was wrong with the film's sensor, one line each."""
        return [] if self._sensor is None else self._sensor.faults()

    def withdraw(self) -> None:
        """Take the tip off the finger and wait until it is, 1.5 s at most.

        Call it right after the last tick: without commands the drive would withdraw by itself,
        and call that a fault.
        """
        self._drive.withdraw("ended")
        deadline_s = time.monotonic() + WITHDRAWN_WITHIN_S
        self._status = self._drive.status()
        while (
            self._status.withdrawal is WithdrawalOutcome.UNDER_WAY
            and time.monotonic() <= deadline_s
        ):
            time.sleep(POLL_S)
            self.read()

    def close(self) -> None:
        """Leave the finger, bring the drive to rest and let go of both."""
        self.withdraw()
        self._drive.close()
        if self._sensor is not None:
            self._sensor.close()
