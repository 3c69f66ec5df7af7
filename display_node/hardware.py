"""The real bench of a display node: its drive and the sensor of its film."""

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from display_node.plant.feedback import Feedback
from display_node.plant.film_plausibility import FilmPlausibility, RisingForce
from display_node.plant.scene import ActuatorScene, StepperScene
from protocol.errors import DriveError, SceneError, SourceError
from protocol.faults import Fault, FaultKind, Part, internal_fault
from protocol.finger import TOUCH_N, FingerState, WithdrawalOutcome
from protocol.tactile import ElasticLayer
from protocol.ticks import LimitCounter
from pulse_drives import Drive, build_drive
from pulse_drives.scene import DriveScene
from pulse_drives.supervisor import FILM_IS_WRONG, GIVEN_UP
from pulse_sensors.sensor import Sensor

FIRST_SAMPLE_WITHIN_S = 5.0
POLL_S = 0.01
# Without a film, the positions of a drive that answers may be missing for its watchdog's time and
# this.
POSITION_LATE_NS = 10_000_000
# Faults from which on the film's readings are false, whenever they come.
FALSE_READINGS = FILM_IS_WRONG - {FaultKind.SILENT, FaultKind.LATE}
_GIVEN_UP = {
    WithdrawalOutcome.UNCONFIRMED: FaultKind.UNCONFIRMED,
    WithdrawalOutcome.WRONG_WAY: FaultKind.TOWARDS_FINGER,
}


def build_display_drive(
    scene: DriveScene,
    actuator: ActuatorScene,
    layer: ElasticLayer,
    force_limit_n: float,
) -> Drive:
    """Build the drive of a contactor, without starting it. Raises SceneError."""
    if (stepper := actuator.stepper) is None:
        raise SceneError('[display] drive: it needs an actuator of kind "stepper"')
    return build_drive(scene, stepper, stepper.deepest_m(layer, force_limit_n))


class Hardware:
    """A drive, and the sensor of the feedback film.

    Without a sensor, the contact law computes the film's reading from the drive's position.

    Attributes
    ----------
    feedback
        The film's readings, as the display takes them.
    measures_force
        True where a film measures the force, and not the contact law.
    at_end
        Counter of ticks in which the drive was slowed before the far end of its travel.
    """

    def __init__(
        self,
        drive: Drive,
        sensor: Sensor | None,
        actuator: StepperScene,
        layer: ElasticLayer,
        feedback: Feedback,
        rising: RisingForce,
        tick_ns: int,
        watchdog_ns: int,
    ) -> None:
        """Combine drive and sensor, which `close` closes. `DisplayScene.hardware` builds it.

        Parameters
        ----------
        feedback
            Takes the film's samples; the display reads it.
        rising
            Check of the slope of the sensor's samples; not used without a sensor.
        watchdog_ns
            Time in ns without a command after which the drive comes to rest by itself.
        """
        self._contact = actuator.contact(layer)
        self._plausibility = FilmPlausibility(actuator, layer)
        self._rising = rising
        # Kept until the next tick reads it, since a sample is read between ticks as well.
        self._film_fault: Fault | None = None
        # The first exception of the film's sensor.
        self._film_error: Fault | None = None
        # Since when the film's readings are known to be wrong.
        self._film_wrong_ns: int | None = None
        self._drive, self._sensor = drive, sensor
        # The drive's last status; the loop's last speed, None before the first; and the travel that
        # the drive was sent until the last tick.
        self._status = drive.status()
        self._speed_m_per_s: float | None = None
        self._travel_m: float | None = None
        self._origin_m = self._unseen_n = 0.0
        self._received_ns = 0
        self.at_end = LimitCounter()
        self._began_ns = time.perf_counter_ns()
        self._tick_ns = tick_ns
        self._watchdog_ns = watchdog_ns
        self.feedback = feedback
        self.measures_force = sensor is not None

    def start(self) -> None:
        """Wait for the film's first sample, then bring the drive to first touch; blocks.

        Raises DriveError. Raises SourceError when no sample comes, before the drive moves.
        """
        deadline_s = time.monotonic() + FIRST_SAMPLE_WITHIN_S
        while self.measures_force and self._read_film() is None:
            if self._film_error is not None:
                raise DriveError(self._film_error.kind, str(self._film_error))
            if time.monotonic() > deadline_s:
                raise SourceError(
                    f"[display.feedback] no sample within {FIRST_SAMPLE_WITHIN_S:g} s:"
                    " check that the film's sensor is the right one, and on"
                )
            time.sleep(POLL_S)
        self._drive.start(self._film_n)
        # Forces on the film before first touch were not caused by the tip.
        self._film_fault = None
        self.read()

    def read(self, now_ns: int | None = None) -> Fault | None:
        """Take new samples and the drive's status; return the fault, if there is one.

        now_ns: time of the tick, at which positions that stand in for a film must not be old.
        """
        newest = self._read_film()
        # Read after the film, because its readings decide about a withdrawal.
        self._status = status = self._drive.status()
        if self._film_error is not None and status.fault is None:
            return self._film_error
        if self._sensor is None:
            if status.received_ns != self._received_ns:
                self._received_ns = status.received_ns
                self.feedback.add(status.received_ns, self._contact.force(self.depth_m))
            if status.fault is None and now_ns is not None:
                return self._late_position(now_ns)
        else:
            self._plausibility.add_position(self.depth_m, status.received_ns)
            if newest is not None and status.fault is None:
                felt_n = newest[1] + self._unseen_n
                contradiction = self._plausibility.check_reading(felt_n, newest[0])
                return self._film_fault or contradiction
        return status.fault

    def _late_position(self, now_ns: int) -> Fault | None:
        status = self._status
        late_ns = now_ns - status.received_ns
        if late_ns <= self._watchdog_ns + POSITION_LATE_NS:
            return None
        if now_ns - status.answered_ns > self._watchdog_ns:
            # Its supervision names a drive that is silent.
            return None
        cause = f"no position for {late_ns * 1e-6:.0f} ms"
        return Fault(FaultKind.NO_POSITION, self._drive.part, cause, now_ns)

    @property
    def position_m(self) -> float:
        """Position of the drive's last report, from first touch."""
        return self._status.position_m

    @property
    def depth_m(self) -> float:
        """The same from the place where the tip touches the finger now."""
        return self._status.position_m - self._origin_m

    def place_finger(self, origin_m: float, unseen_n: float) -> None:
        """Set the position of a finger that presses, and its force that the film does not see."""
        self._origin_m, self._unseen_n = origin_m, unseen_n
        self._drive.place_finger(origin_m)

    def overrun(self, elapsed_ticks: int, now_ns: int) -> Fault | None:
        """Return the fault if the drive came to rest because a tick is too late.

        Before the first command it rests at first touch, and its watchdog does not run.
        """
        silent_ns = elapsed_ticks * self._tick_ns
        if silent_ns <= self._watchdog_ns or self._speed_m_per_s is None:
            return None
        cause = f"overrun: no command for {silent_ns * 1e-6:.0f} ms"
        return Fault(FaultKind.OVERRUN, Part.LOOP, cause, now_ns)

    def deviation_m(self, now_ns: int, held_ticks: int) -> float:
        """Return the travel sent to the drive since the last tick minus that of the loop, in m.

        It differs from 0 where a change of speed was sent late or not at all. held_ticks: number of
        ticks since then in which the loop has assumed its last speed.
        """
        before_m, self._travel_m = self._travel_m, self._drive.travel_m(now_ns)
        if before_m is None:
            return 0.0
        speed_m_per_s = self._speed_m_per_s or 0.0
        return self._travel_m - before_m - speed_m_per_s * (held_ticks * self._tick_ns) * 1e-9

    def command(
        self, speed_m_per_s: float, faults: Sequence[Fault], contactor: str = ""
    ) -> Fault | None:
        """Command a speed until the next tick, or after a fault the withdrawal.

        contactor: name by which faults are of this bench; those of others are of other films.
        Returns the fault of a withdrawal that failed.
        """
        self._speed_m_per_s = speed_m_per_s
        if not faults:
            self._drive.command(speed_m_per_s)
            self.at_end.add(self._status.held_back)
            return None
        of_film = [f for f in faults if f.part is Part.FILM and f.contactor == contactor]
        if self._film_wrong_ns is None:
            times_ns = (f.at_ns for f in of_film if f.kind in FALSE_READINGS)
            self._film_wrong_ns = next(times_ns, None)
        trusted = all(fault.kind not in FILM_IS_WRONG for fault in of_film)
        self._drive.withdraw(faults[0], trusted)
        # After a fault no command is sent; `held_back` still belongs to the last one: not counted.
        self.at_end.add(limited=False)
        return self._failed_withdrawal()

    def _failed_withdrawal(self) -> Fault | None:
        outcome = self._status.withdrawal
        if outcome is None or outcome not in GIVEN_UP:
            return None
        cause = f"withdrawal: {outcome.value}"
        return Fault(_GIVEN_UP[outcome], self._drive.part, cause, time.perf_counter_ns())

    def finger(self, now_ns: int) -> FingerState:
        """Return the state of the finger as it was read last."""
        status, newest = self._status, self.feedback.newest
        since_ns = self._began_ns if newest is None else newest[0]
        known = newest is not None and self.feedback.alive(now_ns)
        blind = not self.measures_force and status.withdrawal in GIVEN_UP
        if self._film_wrong_ns is not None and self.measures_force:
            since_ns, blind = self._film_wrong_ns, True
        return FingerState(
            force_n=newest[1] if newest is not None and known and not blind else None,
            unknown_s=(now_ns - since_ns) * 1e-9,
            measured_by="" if self.measures_force else "by the drive's position",
            outcome=status.withdrawal,
            answers=now_ns - status.answered_ns <= self._watchdog_ns,
        )

    def _film_n(self) -> float | None:
        """Return the newest reading of the film; None without one."""
        self._read_film()
        newest = self.feedback.newest if self.measures_force else None
        return None if newest is None else newest[1]

    def _read_film(self) -> tuple[int, float] | None:
        """Pass on the film's new samples; return the newest one, None without any.

        An exception of the sensor is a fault of the film: the drive goes on to be withdrawn.
        """
        samples = self.feedback.samples
        try:
            for block in [] if self._sensor is None else self._sensor.poll():
                for taken_ns, force_n in zip(block.times_ns, block.force_n, strict=True):
                    self.feedback.add(taken_ns, force_n)
                    self._film_fault = self._film_fault or self._rising.check_reading(
                        force_n, taken_ns
                    )
        except Exception as error:
            now_ns = time.perf_counter_ns()
            self._film_error = self._film_error or internal_fault(
                Part.FILM, "loop, film", error, now_ns
            )
        newest = self.feedback.newest
        if newest is None or self.feedback.samples == samples:
            return None
        self._drive.add_force_reading(newest[1], newest[0])
        return newest

    @property
    def counts(self) -> Counter[str]:
        """Line errors of drive and film that the next message corrected, readings out of order."""
        counts = Counter({f"drive {name}": n for name, n in self._drive.counts.items()})
        if self._sensor is not None:
            counts.update({f"film {name}": n for name, n in self._sensor.rejected.items()})
        counts["film out of order"] = self.feedback.out_of_order
        return +counts

    def faults(self) -> list[str]:
        """Return the errors of the film's sensor, one line each."""
        return [] if self._sensor is None else self._sensor.faults()

    def begin_withdrawal(self) -> None:
        """Command the withdrawal of the tip from the finger, without waiting.

        Call it right after the last tick: if called later, the drive's watchdog would report a
        fault first.
        """
        self._drive.withdraw()

    def withdraw(self) -> Fault | None:
        """Withdraw the tip from the finger, and wait until it is off, as long as that may take.

        Returns the fault of a tip that may still press.
        """
        self.begin_withdrawal()
        fault = self._drive.await_withdrawal(self.read)
        self.read()
        if fault is None:
            return None
        force_n = self.finger(fault.at_ns).force_n
        if self.measures_force and force_n is not None and force_n < TOUCH_N:
            return None
        felt = "an unknown force" if force_n is None else f"{force_n * 1e3:.0f} mN"
        return replace(fault, cause=f"{fault.cause}, with {felt}")

    def close(self) -> None:
        """Withdraw the tip, bring the drive to rest and close drive and sensor."""
        try:
            self.withdraw()
        finally:
            self._drive.close()
            if self._sensor is not None:
                self._sensor.close()
