"""A sensor on a CAN bus: a signal of a DBC database, over any interface of python-can."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from protocol.errors import SourceError
from pulse_sensors import library
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.plausibility import is_usable, unit_contradiction
from pulse_sensors.samples import LONGEST_PAUSE_NS, SampleBlock, SampleCounter, one_channel

if TYPE_CHECKING:
    import can

WAIT_S = 0.1


class CanScene(SensorTable):
    """The `source` table of kind "can".

    interface, channel, bitrate: those of python-can. options: further settings of the interface.
    database: a .dbc (or another kind that cantools reads), relative to the scene's folder. signal:
    name of the force in it. counter: name of a signal that counts samples, if there is one.
    message: name of the message, required when several messages have the signal.
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
    """Port that receives the messages of one id; see `pulse_sensors.sensor.Port`."""

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
        # Imported here, since it takes 0.1 s, which scenes without CAN save.
        import can

        try:
            self._bus = can.Bus(**self._settings)
        except Exception as error:  # each interface raises its driver's errors
            raise SourceError(f"{self.name}: cannot be opened: {error}") from None

    def read(self) -> "can.Message | None":
        """Return the next message; None after 0.1 s without one. Raises if the bus is gone."""
        message: can.Message | None = self._bus.recv(WAIT_S)
        return message

    def close(self) -> None:
        """Release the bus."""
        if self._bus is not None:
            self._bus.shutdown()
            self._bus = None


class CanDecoder:
    """Decoder of a signal's values; their times are those of the interface.

    folder: folder of the scene's file. frame_id, extended: id and kind of the message with the
    signal. Raises SourceError if the database cannot be read or does not fit the scene.
    """

    def __init__(self, scene: CanScene, folder: Path) -> None:
        path = folder / scene.database
        database_library = library("cantools.database", "a CAN sensor")
        try:
            database = database_library.load_file(path)
        except FileNotFoundError:
            raise SourceError(f"{path}: no such database") from None
        except Exception as error:  # parsers raise many kinds for a damaged file
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise SourceError(f"{path}: cannot be read: {reason:.200}") from None
        self._message = _find_message(scene, path, database.messages)
        signals = {signal.name: signal for signal in self._message.signals}
        contradiction = unit_contradiction(signals[scene.signal].unit, scene.unit)
        if contradiction is not None:
            raise SourceError(f"{path}: {scene.signal!r} {contradiction}")
        if scene.counter and scene.counter not in signals:
            known = _names(self._message.signals)
            raise SourceError(
                f"{path}: {self._message.name} has no signal {scene.counter!r}; it has {known}"
            )
        self._signal, self._counter_name = scene.signal, scene.counter
        self._modulus = 1 << signals[scene.counter].length if scene.counter else 1
        self._decode_error = database_library.DecodeError
        self._period_ns = scene.period_ns
        self.frame_id: int = self._message.frame_id
        self.extended: bool = self._message.is_extended_frame
        self.rejected: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Start anew with the next message, for example after the bus was gone."""
        self._last_ns: int | None = None
        self._counter = SampleCounter(self._modulus, self._period_ns, self.rejected)

    def feed(self, message: "can.Message") -> list[SampleBlock]:
        """Return the block in a message; none if a multiplexed message has another signal."""
        if message.is_error_frame:
            return self._reject("bus_error")
        try:
            signals = self._message.decode(bytes(message.data), decode_choices=False)
            counted = int(signals.get(self._counter_name, 0))
        except (self._decode_error, ValueError, OverflowError):
            return self._reject("not_decoded")
        if self._signal not in signals:
            return []
        value = float(signals[self._signal])
        if not is_usable(value):
            return self._reject("not_finite")
        device_ns = round(message.timestamp * 1e9) or None
        passed_ns = None
        if device_ns is not None and self._last_ns is not None:
            passed_ns = device_ns - self._last_ns
            passed_ns = passed_ns if 0 < passed_ns <= LONGEST_PAUSE_NS else None
        self._last_ns = device_ns
        missing = self._counter.missing(counted, 1, passed_ns) if self._counter_name else 0
        return [one_channel((value,), device_ns, missing, restarted=passed_ns is None)]

    def _reject(self, cause: str) -> list[SampleBlock]:
        self.rejected[cause] += 1
        return []


def _find_message(scene: CanScene, path: Path, messages: Iterable[Any]) -> Any:
    """Return the message that carries the scene's signal. Raises SourceError."""
    named = [m for m in messages if scene.message in (None, m.name)]
    if not named:
        raise SourceError(f"{path}: no message {scene.message!r}; it has {_names(messages)}")
    having = [m for m in named if any(s.name == scene.signal for s in m.signals)]
    if not having:
        known = _names(signal for message in named for signal in message.signals)
        raise SourceError(f"{path}: no signal {scene.signal!r}; it has {known}")
    if len(having) > 1:
        raise SourceError(f"{path}: {scene.signal!r} is in {_names(having)}; say which: message")
    return having[0]


def _names(parts: Iterable[Any]) -> str:
    return ", ".join(part.name for part in parts)[:200]
