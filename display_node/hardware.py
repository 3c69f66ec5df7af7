"""The real bench of a display node: the drive that is commanded and the film that is read."""

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from display_node.actuators.stepper import StepperScene
from display_node.drives import Drive, build_drive
from display_node.feedback import Feedback
from display_node.scene import DisplayScene
from display_node.step_rate import StepRate
from protocol.errors import SceneError, SourceError
from sensors.scene import open_sensor
from sensors.sensor import Sensor

FIRST_SAMPLE_WITHIN_S = 5.0
POLL_S = 0.01
# Away from the finger after a fault: 0.3 mm, a usual pulse's travel, in some 15 ms.
RETRACT_M_PER_S = 0.02


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
    with closing(Hardware(scene, folder, log)) as hardware:
        hardware.start()
        yield hardware


class Hardware:
    """A drive, and the sensor of the feedback film.

    Without a sensor the film is told by the model of contact, from where the drive says it is.
    feedback: what the display reads.
    """

    def __init__(self, scene: DisplayScene, folder: Path, log: Callable[[str], None]) -> None:
        """`folder` is the scene file's. Raises SceneError for a scene that names no real drive
        or does not fit it, and SourceError for a sensor that is not there."""
        if scene.drive is None or not isinstance(scene.actuator, StepperScene):
            raise SceneError('[display] drive: it needs an actuator of kind "stepper"')
        self._contact = scene.actuator.contact(scene.layer.layer())
        step_m = scene.actuator.step_m
        self._step_rate = StepRate(1 / step_m, scene.actuator.max_speed_m_per_s / step_m)
        self._log = log
        self._drive: Drive = build_drive(
            scene.drive, scene.actuator, scene.layer.layer(), scene.safety.force_limit_n
        )
        self._sensor: Sensor | None = None
        if scene.feedback is not None:
            self._sensor = open_sensor(scene.feedback, folder, log)
        self.feedback = Feedback(scene.film.latency_ns, scene.safety.feedback_within_ns)

    def start(self) -> None:
        """Bring the drive to first touch and wait for the film's first sample; blocks.

        Raises DriveError, and SourceError when no sample comes.
        """
        self._drive.start()
        self._log("the drive is at first touch")
        deadline_s = time.monotonic() + FIRST_SAMPLE_WITHIN_S
        while not self.feedback.alive(time.monotonic_ns()):
            if time.monotonic() > deadline_s:
                raise SourceError(
                    f"[display.feedback] no sample within {FIRST_SAMPLE_WITHIN_S:g} s:"
                    " is the film's sensor the right one, and on?"
                )
            time.sleep(POLL_S)
            self.read(time.monotonic_ns())

    def read(self, now_ns: int) -> str | None:
        """Hand what has come to `feedback`; the drive's fault, if it has one."""
        status = self._drive.status()
        if self._sensor is None:
            self.feedback.hear(now_ns - status.age_ns, self._contact.force(status.position_m))
        else:
            for reading in self._sensor.poll():
                step_ns = (reading.end_ns - reading.first_ns) / len(reading.force_n)
                for number, force_n in enumerate(reading.force_n):
                    self.feedback.hear(reading.first_ns + round(number * step_ns), force_n)
        return None if status.fault is None else f"drive: {status.fault}"

    def move(self, speed_m_per_s: float) -> None:
        """Go on at a speed until the next tick."""
        self._drive.command(self._step_rate.command(speed_m_per_s))

    def retract(self) -> None:
        """After a fault: back to where nothing is touched, if the drive still obeys."""
        self._drive.command(self._step_rate.command(-RETRACT_M_PER_S))

    @property
    def counts(self) -> Counter[str]:
        """What went wrong on the way to drive and film and was made good, by name."""
        counts = Counter({f"drive {name}": n for name, n in self._drive.counts.items()})
        if self._sensor is not None:
            counts.update({f"film {name}": n for name, n in self._sensor.rejected.items()})
        return counts

    def faults(self) -> list[str]:
        """What was wrong with the film's sensor, one line each."""
        return [] if self._sensor is None else self._sensor.faults()

    def close(self) -> None:
        """Bring the drive to rest and let go of both."""
        self._drive.close()
        if self._sensor is not None:
            self._sensor.close()
