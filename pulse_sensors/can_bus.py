"""A sensor on a CAN bus: a signal of a DBC database, through any interface of python-can."""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from protocol.errors import SourceError
from pulse_sensors.device_counters import LONGEST_PAUSE_NS, SampleCounter
from pulse_sensors.extra import library
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.reading import LARGEST, Packet

if TYPE_CHECKING:
    import can

WAIT_S = 0.1


class CanScene(SensorTable):
    """The `source` table of kind "can".

    interface, channel, bitrate: python-can's; options: what else the interface takes. database:
    a .dbc (or another kind that cantools reads), from the scene's folder; signal: the force's
    name in it; counter: of a signal that counts samples, if there is one; message: needed when
    several messages have the signal.
    """

    kind: Literal["can"]
    interface: Annotated[str, Field(min_length=1)]
    channel: Annotated[str, Field(min_length=1)]
    database: Path
    signal: Annotated[str, Field(min_length=1)]
    bitrate: Annotated[int, Field(ge=1_000, le=1_000_000)] | None = None
    message: str | None = None
    counter: str | None = None
    options: dict[str, str | int | float | bool] = Field(default_factory=dict)


class CanBus:
    """Messages of one id from a CAN bus."""

    def __init__(self, scene: CanScene, frame_id: int, extended: bool) -> None:
        self.name = f"{scene.interface} {scene.channel}"
        self._settings: dict[str, Any] = {
            "interface": scene.interface,
            "channel": scene.channel,
            "can_filters": [{"can_id": frame_id, "can_mask": 0x1FFF_FFFF, "extended": extended}],
            **({} if scene.bitrate is None else {"bitrate": scene.bitrate}),
            **scene.options,
        }
        self._bus: Any = None

    def open(self) -> None:
        """Open the bus. Raises SourceError when it cannot be used."""
        # python-can takes a tenth of a second to import; scenes without it do without.
        import can

        try:
            self._bus = can.Bus(**self._settings)
        except Exception as error:  # each interface raises what its driver does
            raise SourceError(f"{self.name}: cannot be opened: {error}") from None

    def read(self) -> "can.Message | None":
        """Return the next message; None after 0.1 s without one. Raises when the bus is gone."""
        message: can.Message | None = self._bus.recv(WAIT_S)
        return message

    def close(self) -> None:
        """Let go of the bus."""
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None


class CanDecoder:
    """The signal's values in messages; their time is the interface's."""

    def __init__(self, scene: CanScene, folder: Path) -> None:
        """`folder` is the scene file's. Raises SourceError."""
        path = folder / scene.database
        self._message = _find_message(scene, path)
        self._signal, self._counter_name = scene.signal, scene.counter
        stated = next(s.unit for s in self._message.signals if s.name == scene.signal)
        if scene.contradicts(stated):
            raise SourceError(
                f'{path}: {scene.signal!r} is in {stated}, the scene says unit = "{scene.unit}";'
                f' set unit = "{stated}"'
            )
        self._bits = self._length(scene.counter, path) if scene.counter else 0
        self._error = library("cantools.database", "a CAN sensor").DecodeError
        self._period_ns = scene.period_ns
        self.frame_id: int = self._message.frame_id
        self.extended: bool = self._message.is_extended_frame
        self.rejected: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Begin anew, as after the bus was gone."""
        self._last_ns: int | None = None
        self._counter = SampleCounter(1 << self._bits, self._period_ns)

    def feed(self, message: "can.Message") -> list[Packet]:
        """Return the packet in a message, if there is one."""
        if message.is_error_frame:
            self.rejected["bus_error"] += 1
            return []
        try:
            signals = self._message.decode(bytes(message.data), decode_choices=False)
            counted = int(signals.get(self._counter_name, 0))
        except (self._error, ValueError, OverflowError):
            self.rejected["not_decoded"] += 1
            return []
        if self._signal not in signals:
            return []  # a multiplexed message that carries others this time
        value = float(signals[self._signal])
        if not abs(value) <= LARGEST:
            self.rejected["not_finite"] += 1
            return []
        device_ns = round(message.timestamp * 1e9) or None
        passed_ns = self._passed_ns(device_ns)
        missing: int | None = 0
        if self._counter_name is not None:
            missing = self._counter.missing(counted, 1, passed_ns)
        if missing is None:
            self.rejected["counter"] += 1
        self._last_ns = device_ns
        return [Packet((value,), device_ns, missing or 0, anew=passed_ns is None)]

    def _passed_ns(self, device_ns: int | None) -> int | None:
        if device_ns is None or self._last_ns is None:
            return None
        passed_ns = device_ns - self._last_ns
        return passed_ns if 0 < passed_ns <= LONGEST_PAUSE_NS else None

    def _length(self, counter: str, path: Path) -> int:
        for signal in self._message.signals:
            if signal.name == counter:
                return int(signal.length)
        names = ", ".join(signal.name for signal in self._message.signals)
        raise SourceError(
            f"{path}: {self._message.name} has no signal {counter!r}; it has {names[:200]}"
        )


def _find_message(scene: CanScene, path: Path) -> Any:
    """Return the message that carries the scene's signal. Raises SourceError."""
    database_library = library("cantools.database", "a CAN sensor")
    try:
        database = database_library.load_file(path)
    except FileNotFoundError:
        raise SourceError(f"{path}: no such database") from None
    except Exception as error:  # damaged, it raises whatever its parsers stumble over
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise SourceError(f"{path}: cannot be read: {reason:.200}") from None
    messages = [m for m in database.messages if scene.message in (None, m.name)]
    if not messages:
        known = ", ".join(m.name for m in database.messages)
        raise SourceError(f"{path}: no message {scene.message!r}; it has {known[:200]}")
    having = [m for m in messages if any(s.name == scene.signal for s in m.signals)]
    if not having:
        known = ", ".join(s.name for m in messages for s in m.signals)
        raise SourceError(f"{path}: no signal {scene.signal!r}; it has {known[:200]}")
    if len(having) > 1:
        names = ", ".join(m.name for m in having)
        raise SourceError(f"{path}: {scene.signal!r} is in {names[:200]}; say which: message")
    return having[0]
