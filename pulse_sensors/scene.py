"""The live sensors a scene can name, and how each is opened."""

import time
from collections.abc import Callable
from pathlib import Path

from pulse_sensors.can_bus import CanBus, CanDecoder, CanScene
from pulse_sensors.lsl_inlet import LslDecoder, LslInlet, LslScene
from pulse_sensors.sensor import Sensor
from pulse_sensors.serial_port import SerialPort, SerialScene

SensorScene = SerialScene | CanScene | LslScene


def open_sensor(
    scene: SensorScene,
    folder: Path,
    clock: Callable[[], int] = time.monotonic_ns,
) -> Sensor:
    """Open the sensor and begin to listen; whoever opens it closes it.

    `folder` is the scene file's, `clock` is `Sensor`'s. Raises SourceError.
    """
    match scene:
        case SerialScene():
            return Sensor(SerialPort(scene), scene.decoder(), scene, clock)
        case CanScene():
            decoder = CanDecoder(scene, folder)
            bus = CanBus(scene, decoder.frame_id, decoder.extended)
            return Sensor(bus, decoder, scene, clock)
        case LslScene():
            return Sensor(LslInlet(scene), LslDecoder(scene.channel), scene, clock)
