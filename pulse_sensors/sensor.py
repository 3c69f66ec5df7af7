"""A live sensor: a thread that reads the device, and the conversion of the data.

The thread waits for data, records the time of arrival, and reopens a device that was gone. The
caller's thread does the rest in `Sensor.poll`.

To add a sensor type:

1. Write a module like `lsl_inlet.py`, with its settings (a `SensorScene`), its `Port`
   and its `Decoder`.
2. Name the settings in `SENSORS` below, or in an entry point of another distribution
   (`docs/howto/plugins.md`). Each table of a scene that describes a sensor then accepts them.
3. Describe its keys in `docs/scenes.md` and the device in `docs/sensors.md`.
"""

import logging
import threading
import time
from abc import abstractmethod
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Protocol, TypeVar

from pydantic import AfterValidator

from protocol.config.kinds import KindGroup, KindTable, OfKind
from protocol.config.quantities import count_text
from protocol.config.scene import Section
from protocol.errors import SourceError
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.samples import DecodedBlock, SampleBlock, Timestamper

logger = logging.getLogger(__name__)

MAX_WAITING = 10_000
REOPEN_EVERY_S = 0.2


class Port(Protocol):
    """A device that can be read."""

    @property
    def name(self) -> str:
        """Name for people."""

    def open(self) -> None:
        """Open the device. Raises SourceError if it is missing or cannot be used."""

    def read(self) -> Any:
        """Wait for data and return it for the decoder; return a false value on timeout.

        Raises driver-specific exceptions if the device is gone.
        """

    def close(self) -> None:
        """Release the device, which may be closed already."""


class Decoder(Protocol):
    """Conversion of a port's data to blocks of samples; unusable data is counted. Pure."""

    @property
    def rejected(self) -> Counter[str]:
        """Count of refusals by cause."""

    def feed(self, data: Any) -> list[DecodedBlock]:
        """Return the blocks completed by this data."""

    def reset(self) -> None:
        """Start anew with the next data, for example after the cable was unplugged."""


class SensorScene(SensorTable, KindTable):
    """Base of the tables of live sensors."""

    @abstractmethod
    def device(self, folder: Path) -> tuple[Port, Decoder]:
        """Return the port and the decoder of its data; `Sensor` opens the port.

        folder: of the scene's file. Raises SourceError where a library or a file is missing.
        """


SENSORS = KindGroup(
    "telepulse.sensors",
    "sensor",
    SensorScene,
    {
        "serial": "pulse_sensors.serial_port:SerialScene",
        "can": "pulse_sensors.can_bus:CanScene",
        "lsl": "pulse_sensors.lsl_inlet:LslScene",
    },
)
TableT = TypeVar("TableT", bound=Section)


def one_force(scene: TableT) -> TableT:
    """Raise ValueError for the table of a live sensor with several channels."""
    if isinstance(scene, SensorScene) and len(scene.wire_channels) > 1:
        names = ", ".join(channel.name for channel in scene.wire_channels)
        raise ValueError(f"one force is read here, and this sensor has several channels: {names}")
    return scene


OneForceSensor = Annotated[SensorScene, OfKind(SENSORS), AfterValidator(one_force)]


class Sensor:
    """A live sensor. Reading starts on construction and ends with `close`.

    settings: rate and scale of the sensor. clock: the host's, in ns. Raises SourceError if the
    device cannot be opened.
    """

    def __init__(
        self,
        port: Port,
        decoder: Decoder,
        settings: SensorTable,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self.period_ns, self.channels = settings.period_ns, settings.wire_channels
        self._port = port
        self._decoder = decoder
        self.timestamper = Timestamper(settings)
        self._clock = clock
        # (time in ns, data | exception: device gone | None: device back)
        self._received: deque[tuple[int, Any]] = deque()
        self._dropped = self._losses = 0
        self._rate_reported = False
        self._gone_since_ns: int | None = None
        self._gone_for_ns = 0
        self._closing = threading.Event()
        port.open()
        self._thread = threading.Thread(target=self._listen, name=port.name, daemon=True)
        self._thread.start()

    def poll(self) -> list[SampleBlock]:
        """Return the calibrated, timestamped samples since the last call. Never waits."""
        blocks = []
        while self._received:
            at_ns, data = self._received.popleft()
            if data is None or isinstance(data, Exception):
                self._note_connection(at_ns, gone=data)
                continue
            for block in self._decoder.feed(data):
                if (timestamped := self.timestamper.timestamp(block, at_ns)) is not None:
                    blocks.append(timestamped)
        if blocks and not self._rate_reported:
            fault = self.timestamper.rate.fault(self._port.name)
            if fault is not None:
                self._rate_reported = True
                logger.warning(fault)
        return blocks

    @property
    def rejected(self) -> Counter[str]:
        """Count of data that could not be used, by cause."""
        rejected = Counter(self._decoder.rejected)
        rejected["not_finite"] += self.timestamper.too_large
        rejected["behind"] += self.timestamper.behind
        rejected["backlog"] += self._dropped
        return +rejected

    def faults(self) -> list[str]:
        """Return the faults so far, one line each."""
        faults = self.timestamper.faults(self._port.name)
        if self._losses:
            gone_ns = self._gone_for_ns
            if self._gone_since_ns is not None:
                gone_ns += self._clock() - self._gone_since_ns
            times = f"{count_text(self._losses, 'time')}, for {gone_ns * 1e-9:.1f} s in all"
            faults.insert(0, f"{self._port.name} was gone {times}")
        return faults

    def close(self) -> None:
        """Stop reading, and release the device."""
        self._closing.set()
        self._thread.join()
        self._port.close()

    def _note_connection(self, at_ns: int, gone: Exception | None) -> None:
        """Log and count the loss or the return of the device."""
        if gone is not None:
            self._losses += 1
            self._gone_since_ns = at_ns
            logger.warning(f"{self._port.name} has gone: {gone}")
        elif self._gone_since_ns is not None:
            self._gone_for_ns += at_ns - self._gone_since_ns
            self._gone_since_ns = None
            self._decoder.reset()
            logger.info(f"{self._port.name} is back")

    def _listen(self) -> None:
        """Read the device until closed; runs in the thread."""
        while not self._closing.is_set():
            try:
                data = self._port.read()
            except Exception as error:  # exception types differ by driver
                self._received.append((self._clock(), error))
                # Closing a device that is gone may fail as well.
                with suppress(Exception):
                    self._port.close()
                self._reopen()
                continue
            if not data:
                continue
            if len(self._received) < MAX_WAITING:
                self._received.append((self._clock(), data))
            else:
                self._dropped += 1

    def _reopen(self) -> None:
        while not self._closing.wait(REOPEN_EVERY_S):
            with suppress(SourceError):
                self._port.open()
                self._received.append((self._clock(), None))
                return


def open_sensor(scene: SensorScene, folder: Path) -> Sensor:
    """Open the sensor of a scene, for the caller to close.

    folder: of the scene's file. Raises SourceError where the device or a library is missing.
    """
    return Sensor(*scene.device(folder), scene)
