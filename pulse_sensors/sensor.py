"""A live sensor: a thread that reads the device, and the conversion of the data.

The thread waits for data, records the time of arrival, and opens a device again that was gone. No
exception of a driver ends it. The caller's thread does the rest in `Sensor.poll`.

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
from typing import Annotated, Any, NamedTuple, Protocol, TypeVar

from pydantic import AfterValidator

from protocol.config.kinds import KindGroup, KindTable, OfKind
from protocol.config.quantities import count_text
from protocol.config.scene import Section
from protocol.errors import SourceError
from protocol.host.guard import GuardedThread
from protocol.refusals import CAUSE_MEANINGS
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.samples import DecodedBlock, SampleBlock, Timestamper, quoted

logger = logging.getLogger(__name__)

MAX_WAITING = 10_000
REOPEN_EVERY_S = 0.2
# Longer than any driver waits for a device that is opened.
CLOSES_WITHIN_S = 10.0
# Time in which data comes until it is judged, and least number of samples that are due in it.
JUDGED_NS, LEAST_DUE = 1_500_000_000, 3


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
        """Count of refusals by cause.

        A decoder may have `refused` beside it: of each cause a sentence with the newest data, as
        they came, and with what to set.
        """

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


class PortFailure(NamedTuple):
    """Why a device gives no data: an exception that it has raised, without what that refers to."""

    text: str
    #: The text names the device, and what failed.
    is_whole: bool
    #: Raised where the device was to be opened again, not where it was read.
    opening: bool


class UnreadData:
    """Check of a device whose data come, and give no samples, or fewer than are refused.

    A warning has the usual cause, the data as they came, and what to set. It is repeated when the
    cause changes, or after a time of good data.

    samples, rejected: numbers of samples and of refusals when the present data began to come.
    fault: the present warning; empty while samples come.
    """

    def __init__(self, name: str, decoder: Decoder, period_ns: int) -> None:
        self._name, self._decoder = name, decoder
        self._judged_ns = max(JUDGED_NS, LEAST_DUE * period_ns)
        self._since_ns: int | None = None
        self._data: Any = None
        self._cause: str | None = None
        self.samples, self.rejected = 0, Counter[str]()
        self.fault = ""

    def take(self, data: Any, at_ns: int) -> None:
        """Note data and their arrival."""
        self._data = data
        if self._since_ns is None:
            self._since_ns = at_ns

    def begin(self, samples: int, rejected: Counter[str]) -> None:
        """Begin anew with the next data."""
        self._since_ns, self.samples, self.rejected = None, samples, rejected

    @property
    def is_open(self) -> bool:
        """True while data that have come are not judged."""
        return self._since_ns is not None

    def due(self, now_ns: int) -> bool:
        """Return whether data have come for long enough to be judged."""
        return self._since_ns is not None and now_ns - self._since_ns >= self._judged_ns

    def judge(self, samples: int, rejected: Counter[str]) -> None:
        """Log a warning where too few samples have come; then begin anew."""
        read, refused = samples - self.samples, rejected - self.rejected
        self.begin(samples, rejected)
        if read > refused.total():
            self._cause, self.fault = None, ""
            return
        # Of each cause its newest data, and what to set.
        sentences: dict[str, str] = getattr(self._decoder, "refused", {})
        cause = refused.most_common(1)[0][0] if refused else next(reversed(sentences), "")
        meaning = CAUSE_MEANINGS.get(cause, "no line, frame or message of the scene's is in it")
        text = sentences.get(cause) or f"{quoted(self._data)}: {meaning}"
        much = f"{read} of {read + refused.total()} samples" if read else "no sample"
        self.fault = f"{self._name} sends, but {much} can be read: {text}"
        if cause != self._cause:
            self._cause = cause
            logger.warning(self.fault)


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
        # (time in ns, data | PortFailure: no data, or for another reason now | None: data again)
        self._received: deque[tuple[int, Any]] = deque()
        self._dropped = 0
        self._unread = UnreadData(port.name, decoder, settings.period_ns)
        self._rate_reported = False
        #: Number of times that the device was gone.
        self.losses = 0
        self._gone_since_ns: int | None = None
        self._gone_for_ns = 0
        # Why a device that has gone cannot be used again; empty before the first attempt.
        self._reason = ""
        self._closing = threading.Event()
        # The thread's: whether the device is open, or being opened; an exception that is not noted
        # yet; the last failure that was noted since data came, and the attempts to open since then.
        self._is_open, self._opening = True, False
        self._error: BaseException | None = None
        self._noted: PortFailure | None = None
        self._attempts = 0
        self._thread = GuardedThread(port.name, self._step, self._on_error)
        port.open()
        self._thread.start()

    def poll(self) -> list[SampleBlock]:
        """Return the calibrated, timestamped samples since the last call. Never waits."""
        blocks = []
        while self._received:
            at_ns, data = self._received.popleft()
            if data is None:
                self._note_return(at_ns)
                continue
            if isinstance(data, PortFailure):
                self._unread.begin(self.timestamper.samples, self.rejected)
                self._note_failure(at_ns, data)
                continue
            self._unread.take(data, at_ns)
            for block in self._decoder.feed(data):
                if (timestamped := self.timestamper.timestamp(block, at_ns)) is not None:
                    blocks.append(timestamped)
            self._judge(at_ns)
        if self._unread.is_open and self.timestamper.samples == self._unread.samples:
            # Without samples, the time passes also without data.
            self._judge(self._clock())
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
        name, faults = self._port.name, []
        if self.losses:
            gone_ns = self._gone_for_ns
            if self._gone_since_ns is not None:
                gone_ns += self._clock() - self._gone_since_ns
            times = f"{count_text(self.losses, 'time')}, for {gone_ns * 1e-9:.1f} s in all"
            faults.append(f"{name} was gone {times}")
        if self._gone_since_ns is not None:
            if self._is_open:
                faults.append(f"{name} is open again, but sends nothing")
            elif self._reason:
                faults.append(f"{self._reason} ({count_text(self._attempts, 'attempt')})")
        if self._unread.fault:
            faults.append(self._unread.fault)
        return [*faults, *self.timestamper.faults(name)]

    def close(self) -> None:
        """Stop reading, and release the device, unless its driver does not return."""
        self._closing.set()
        if not self._thread.stop(CLOSES_WITHIN_S):
            logger.error(f"{self._port.name} cannot be closed: its driver hangs")
            return
        try:
            self._port.close()
        except Exception as error:  # exception types differ by driver
            logger.warning(f"{self._port.name} cannot be closed: {_text(error)}")

    def _judge(self, now_ns: int) -> None:
        if self._unread.due(now_ns):
            self._unread.judge(self.timestamper.samples, self.rejected)

    def _note_failure(self, at_ns: int, failure: PortFailure) -> None:
        """Log why the device gives no data; count it where it has just gone."""
        name, text = self._port.name, failure.text
        if self._gone_since_ns is None:
            self.losses += 1
            self._gone_since_ns, self._reason = at_ns, ""
            logger.warning(f"{name} has gone: {text}")
            return
        if failure.is_whole:
            self._reason = text
        else:
            tried = "cannot be opened" if failure.opening else "opens, but cannot be read"
            self._reason = f"{name}: {tried}: {text}"
        logger.warning(self._reason)

    def _note_return(self, at_ns: int) -> None:
        """Log that a device that was gone sends again."""
        if self._gone_since_ns is not None:
            self._gone_for_ns += at_ns - self._gone_since_ns
        self._gone_since_ns = None
        self._decoder.reset()
        logger.info(f"{self._port.name} is back")

    def _step(self) -> None:
        """Read the device, or open it again; runs in the thread."""
        if self._is_open:
            self._read()
        else:
            self._reopen()

    def _on_error(self, error: BaseException) -> None:
        self._error, self._is_open = error, False

    def _read(self) -> None:
        """Wait for data, and store them with the time of their arrival."""
        if not (data := self._port.read()):
            return
        now_ns = self._clock()
        if self._noted is not None:
            self._received.append((now_ns, None))
            self._noted = None
        if len(self._received) < MAX_WAITING:
            self._received.append((now_ns, data))
        else:
            self._dropped += 1

    def _reopen(self) -> None:
        """Note why the device gives no data, where that is new, and open it again."""
        try:
            if self._error is not None:
                self._note(self._error)
                self._error = None
            # Closing a device that is gone may fail as well.
            with suppress(Exception):
                self._port.close()
        finally:
            # Also after an exception in here.
            closing = self._closing.wait(REOPEN_EVERY_S)
        if not closing:
            self._opening = True
            self._attempts += 1
            self._port.open()
            self._opening, self._is_open = False, True

    def _note(self, error: BaseException) -> None:
        """Store an exception of the device, unless the last one was the same."""
        failure = PortFailure(_text(error), isinstance(error, SourceError), self._opening)
        if self._noted is None:
            self._attempts = 0
        if failure != self._noted:
            self._received.append((self._clock(), failure))
            self._noted = failure


def _text(error: BaseException) -> str:
    return str(error) or type(error).__name__


def open_sensor(scene: SensorScene, folder: Path) -> Sensor:
    """Open the sensor of a scene, for the caller to close.

    folder: of the scene's file. Raises SourceError where the device or a library is missing.
    """
    return Sensor(*scene.device(folder), scene)
