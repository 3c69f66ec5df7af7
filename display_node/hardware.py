"""The real bench of a display node: the drive that is commanded and the film that is read."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from display_node.actuators.stepper import StepperScene
from display_node.display import Display, Felt
from display_node.drives import Drive, build_drive
from display_node.drives.approach import WITHDRAW_M_PER_S, withdraw
from display_node.feedback import Feedback
from display_node.scene import DisplayScene
from protocol.errors import SceneError, SourceError
from protocol.limits import LimitCounter
from sensors.scene import open_sensor
from sensors.sensor import Sensor

FIRST_SAMPLE_WITHIN_S = 5.0
POLL_S = 0.01


@contextmanager
def connected(
    scene: DisplayScene, folder: Path, log: Callable[[str], None]
) -> Iterator["Hardware | None"]:
    """The bench of a scene, started, within a `with`; None for a scene that names no drive.

    `folder` is the scene file's. Raises SceneError, SourceError and DriveError.
    """
    if scene.drive is None:
        yield None
        return
    layer, force_limit_n = scene.layer.layer(), scene.safety.force_limit_n
    drive = build_drive(scene.drive, scene.actuator, layer, force_limit_n)
    sensor = open_sensor(scene.feedback, folder, log) if scene.feedback is not None else None
    with closing(Hardware(scene, drive, sensor)) as hardware:
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
        self._step_m = actuator.step_m
        self._step_rate = actuator.step_rate()
        self._drive = drive
        self._sensor = sensor
        self._heard_ns = 0
        self._held_back = False
        self.at_end = LimitCounter()
        # Where the drive's commands had led to at the last tick.
        self._way_m: float | None = None
        self._tick_ns = scene.tick_ns
        self._watchdog_ns = scene.drive.watchdog_ns
        self.feedback = Feedback(scene.film.latency_ns, scene.safety.feedback_within_ns)

    def start(self) -> None:
        """Bring the drive to first touch and wait for the film's first sample; blocks.

        Raises DriveError, and SourceError when no sample comes.
        """
        self._drive.start()
        deadline_s = time.monotonic() + FIRST_SAMPLE_WITHIN_S
        while not self.feedback.alive(time.monotonic_ns()):
            if time.monotonic() > deadline_s:
                raise SourceError(
                    f"[display.feedback] no sample within {FIRST_SAMPLE_WITHIN_S:g} s:"
                    " is the film's sensor the right one, and on?"
                )
            time.sleep(POLL_S)
            self.read()

    def read(self) -> str | None:
        """Hand what has come to `feedback`; the drive's fault, if it has one."""
        status = self._drive.status()
        self._held_back = status.held_back
        if self._sensor is None:
            if status.heard_ns != self._heard_ns:
                self._heard_ns = status.heard_ns
                self.feedback.hear(status.heard_ns, self._contact.force(status.position_m))
        else:
            for reading in self._sensor.poll():
                for taken_ns, force_n in zip(reading.times_ns, reading.force_n, strict=True):
                    self.feedback.hear(taken_ns, force_n)
        return None if status.fault is None else f"drive: {status.fault}"

    def tick(self, display: Display, now_ns: int, elapsed_ticks: int) -> Felt:
        """A tick of a display on this bench: it is told within it what the controller wants, or
        after a fault to go back."""
        safety = display.safety
        fault = self.read()
        if fault is not None:
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
        self.at_end.add(self._held_back and not safety.faults)
        if safety.faults:
            self._move(-WITHDRAW_M_PER_S)
        else:
            self._move(display.output)
        return felt

    def _move(self, speed_m_per_s: float) -> None:
        """Go on at a speed until the next tick."""
        self._drive.command(self._step_rate.command(speed_m_per_s))

    @property
    def counts(self) -> Counter[str]:
        """What went wrong on the way to drive and film and was made good, by name."""
        counts = Counter({f"drive {name}": n for name, n in self._drive.counts.items()})
        if self._sensor is not None:
            counts.update({f"film {name}": n for name, n in self._sensor.rejected.items()})
        counts["film out of order"] = self.feedback.out_of_order
        return +counts

    def faults(self) -> list[str]:
        """What was wrong with the film's sensor, one line each."""
        return [] if self._sensor is None else self._sensor.faults()

    def withdraw(self) -> None:
        """Take the tip off the finger; blocks, half a second at most. Call it right after the
        last tick: a drive that hears nothing any more stays where it is."""
        withdraw(self._drive, self._step_m)

    def close(self) -> None:
        """Leave the finger, bring the drive to rest and let go of both."""
        self.withdraw()
        self._drive.close()
        if self._sensor is not None:
            self._sensor.close()
