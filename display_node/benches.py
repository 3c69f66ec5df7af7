"""Start of the real benches of a display, and of the live sensor of its finger's press."""

import logging
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

from display_node.hardware import Hardware, build_display_drive
from display_node.scene import DisplayScene, FilmSensor
from protocol.errors import SceneError
from pulse_drives import Drive
from pulse_drives.scene import DriveScene
from pulse_drives.start_advice import advised
from pulse_sensors.drive_film import DriveFilmDecoder, DriveFilmScene
from pulse_sensors.sensor import Sensor, open_sensor

logger = logging.getLogger(__name__)


@contextmanager
def start_benches(
    scene: DisplayScene, folder: Path, without_film: bool = False
) -> Iterator[list[Hardware | None]]:
    """Start the real bench of each contactor within a `with`; yield None for one without a drive.

    folder: of the scene's file. without_film: whether a drive may press although no film measures
    the force. Raises SceneError, SourceError or DriveError where a part is missing in the scene, or
    the film's sensor or the drive does not answer.
    """
    with ExitStack() as stack:
        benches = [
            None
            if contactor.drive is None
            else stack.enter_context(_start_bench(contactor, contactor.drive, folder, without_film))
            for contactor in scene.contactors
        ]
        # A film's samples of the seconds in which the further drives were homed: the first tick
        # would take as long as a watchdog.
        for bench in benches:
            if bench is not None:
                bench.read()
        yield benches


@contextmanager
def open_press(scene: DisplayScene, folder: Path) -> Iterator[Sensor | None]:
    """Open the live sensor of the finger's press within a `with`; yield None without one.

    folder: of the scene's file. Raises SourceError.
    """
    if scene.press is None or (table := scene.press.live_sensor) is None:
        yield None
        return
    with closing(open_sensor(table, folder)) as sensor:
        yield sensor


def open_film(table: FilmSensor, drive: Drive, overforce_n: float, folder: Path) -> Sensor:
    """Open the sensor of a film, for the caller to close, before its drive is started.

    overforce_n: felt force that is a fault, the hard limit of a drive that reads the film. folder:
    of the scene's file. Raises SourceError.
    """
    if not isinstance(table, DriveFilmScene):
        return open_sensor(table, folder)
    port = drive.film_port(*table.counts_within(overforce_n))
    return Sensor(port, DriveFilmDecoder(table.period_ns), table)


@contextmanager
def _start_bench(
    scene: DisplayScene, table: DriveScene, folder: Path, without_film: bool
) -> Iterator[Hardware]:
    if scene.feedback is None and not without_film:
        raise SceneError(
            "[display.feedback] is missing: without a film nothing measures the force, and a drive"
            " that turns further than it counts is not detected; add the film, or give"
            " --without-film if no person's finger is pressed"
        )
    layer, force_limit_n = scene.layer.layer(), scene.safety.force_limit_n
    drive = build_display_drive(table, scene.actuator, layer, force_limit_n)
    film = scene.feedback
    sensor = None if film is None else open_film(film, drive, scene.safety.overforce_n, folder)
    with closing(scene.hardware(drive, sensor)) as hardware:
        logger.warning("the drive looks for its home: keep the finger away")
        with advised():
            hardware.start()
        logger.info("the drive is at first touch")
        yield hardware
