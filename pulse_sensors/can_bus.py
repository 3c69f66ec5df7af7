"""A sensor on a CAN bus: signals of a DBC database, over any interface of python-can."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from protocol.errors import SourceError
from protocol.input_files import open_regular
from protocol.wire.description import PULSE
from pulse_sensors import library
from pulse_sensors.force_scale import MAX_VALUES
from pulse_sensors.sample_plausibility import is_usable, unit_contradiction
from pulse_sensors.samples import LONGEST_PAUSE_NS, DecodedBlock, SampleCounter, decoded_block
from pulse_sensors.sensor import SensorScene

if TYPE_CHECKING:
    import can

SignalName = Annotated[str, Field(min_length=1)]
SignalNames = Annotated[tuple[SignalName, ...], Field(min_length=1, max_length=MAX_VALUES)]
WAIT_S = 0.1
# Largest database that is read: those of whole vehicles have 2 MB.
MOST_DATABASE_BYTES = 1 << 24


class CanScene(SensorScene):
    """The `source` table of kind "can".

    interface, channel, bitrate: those of python-can. options: further settings of the interface.
    database: a .dbc (or another kind that cantools reads), relative to the scene's folder. signal:
    name of the force in it. signals: those of several channels, all in one message. counter: name
    of a signal that counts samples, if there is one. message: name of the message, required when
    several messages have the signals.
    """

    kind: Literal["can"]
    interface: Annotated[str, Field(min_length=1)]
    channel: Annotated[str, Field(min_length=1)]
    database: Path
    signal: SignalName | None = None
    signals: SignalNames | None = None
    bitrate: Annotated[int, Field(ge=1_000, le=1_000_000)] | None = None
    message: str | None = None
    counter: str | None = None
    options: dict[str, str | int | float | bool] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _has_a_signal(self) -> Self:
        if (self.signal is None) == (self.signals is None):
            raise ValueError("signal is one, signals are several; give one of the two keys")
        return self

    def device(self, folder: Path) -> "tuple[CanBus, CanDecoder]":
        """See `SensorScene.device`."""
        decoder = CanDecoder(self, folder)
        return CanBus(self, decoder.frame_id, decoder.extended), decoder

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Signals of a sample's values."""
        return self.signals or (self.signal or "",)

    @property
    def value_names(self) -> tuple[str, ...]:
        """Names of a sample's values, in order, where the scene gives none."""
        return (PULSE,) if self.signals is None else self.signals


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
    """Decoder of the signals of one message; their times are those of the interface.

    folder: folder of the scene's file. frame_id, extended: id and kind of the message with the
    signals. Raises SourceError if the database cannot be read or does not fit the scene.
    """

    def __init__(self, scene: CanScene, folder: Path) -> None:
        path = folder / scene.database
        database_library = library("cantools.database", "a CAN sensor")
        try:
            # The library opens it again: the format is that of the name.
            open_regular(path, MOST_DATABASE_BYTES).close()
            database = database_library.load_file(path)
        except FileNotFoundError:
            raise SourceError(f"{path}: no such database") from None
        except Exception as error:  # parsers raise many kinds for a damaged file
            text = str(getattr(error, "strerror", None) or error)
            reason = (text.splitlines() or [type(error).__name__])[0]
            raise SourceError(f"{path}: cannot be read: {reason:.200}") from None
        self._message = _find_message(scene, path, database.messages)
        signals = {signal.name: signal for signal in self._message.signals}
        for name, channel in zip(scene.signal_names, scene.wire_channels, strict=True):
            unit = scene.announce_unit if channel.announces else scene.unit
            contradiction = unit_contradiction(signals[name].unit, unit)
            if contradiction is not None:
                key = "announce_unit" if channel.announces else "unit"
                raise SourceError(f"{path}: {name!r} {contradiction.replace('unit', key)}")
        if scene.counter and scene.counter not in signals:
            known = _names(self._message.signals)
            raise SourceError(
                f"{path}: {self._message.name} has no signal {scene.counter!r}; it has {known}"
            )
        self._signals, self._counter_name = scene.signal_names, scene.counter
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

    def feed(self, message: "can.Message") -> list[DecodedBlock]:
        """Return the block in a message; none if a multiplexed message has another signal."""
        if message.is_error_frame:
            return self._reject("bus_error")
        try:
            signals = self._message.decode(bytes(message.data), decode_choices=False)
            counted = int(signals.get(self._counter_name, 0))
        except (self._decode_error, ValueError, OverflowError):
            return self._reject("not_decoded")
        if not all(name in signals for name in self._signals):
            return []
        values = [float(signals[name]) for name in self._signals]
        if not all(map(is_usable, values)):
            return self._reject("not_finite")
        device_ns = round(message.timestamp * 1e9) or None
        passed_ns = None
        if device_ns is not None and self._last_ns is not None:
            passed_ns = device_ns - self._last_ns
            passed_ns = passed_ns if 0 < passed_ns <= LONGEST_PAUSE_NS else None
        self._last_ns = device_ns
        missing = self._counter.missing(counted, 1, passed_ns) if self._counter_name else 0
        return [decoded_block([values], device_ns, missing, restarted=passed_ns is None)]

    def _reject(self, cause: str) -> list[DecodedBlock]:
        self.rejected[cause] += 1
        return []


def _find_message(scene: CanScene, path: Path, messages: Iterable[Any]) -> Any:
    """Return the message that carries the scene's signals. Raises SourceError."""
    named = [m for m in messages if scene.message in (None, m.name)]
    if not named:
        raise SourceError(f"{path}: no message {scene.message!r}; it has {_names(messages)}")
    wanted = scene.signal_names
    for name in wanted:
        if not any(s.name == name for m in named for s in m.signals):
            known = _names(signal for message in named for signal in message.signals)
            raise SourceError(f"{path}: no signal {name!r}; it has {known}")
    having = [m for m in named if {s.name for s in m.signals}.issuperset(wanted)]
    titles = ", ".join(map(repr, wanted))
    if len(having) > 1:
        raise SourceError(f"{path}: {titles} is in {_names(having)}; say which: message")
    if not having:
        raise SourceError(
            f"{path}: {titles} are in several messages; the signals of one sensor come together"
        )
    pages = [
        set(s.multiplexer_ids) for s in having[0].signals if s.name in wanted and s.multiplexer_ids
    ]
    if pages and not set.intersection(*pages):
        raise SourceError(
            f"{path}: {titles} are never in one message: {having[0].name} has them on several pages"
        )
    return having[0]


def _names(parts: Iterable[Any]) -> str:
    return ", ".join(part.name for part in parts)[:200]
