"""Description of a stream, which a display needs to convert frames to strain.

The sensing node sends it in its welcome, so that displays which join late receive it too.
The frames are in `messages.py`.
"""

import dataclasses
from collections.abc import Iterable
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from protocol.config.quantities import Metres, Name, Pascals
from protocol.config.scene import Section
from protocol.errors import WireError
from protocol.tactile import ElasticLayer

NameT = TypeVar("NameT", str, int)
_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)


ANNOUNCE = "announce"
"""Name of a channel that announces the beats, whatever its unit."""
PULSE = "pulse"
"""Name of the channel of a source with one channel."""
HOLD_DOWN = "hold-down"
"""Name of the channel of the load cell under a probe at the wrist."""
SECOND_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, config=_STRICT)
class Channel:
    """One channel of the stream: its name and its unit, N of a force or mV of an ECG."""

    name: Name
    unit: Literal["N", "mV"] = "N"

    @property
    def announces(self) -> bool:
        """True for a channel that announces the beats before their pulse arrives, as an ECG."""
        return self.unit == "mV" or self.name == ANNOUNCE


def _distinct(channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
    twice = first_repeated(channel.name for channel in channels)
    if twice is not None:
        raise ValueError(f"two channels have the name {twice!r}")
    return channels


def first_repeated(names: Iterable[NameT]) -> NameT | None:
    """Return the first name or number that occurs a second time, or None."""
    seen: set[NameT] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None


@dataclass(frozen=True, slots=True, config=_STRICT)
class StreamDescription:
    """Content of a stream's frames.

    Attributes
    ----------
    name : str
        Name of the stream, 1 to 80 printable characters.
    period_ns : int
        Time between samples, 1 µs to 10 s.
    batch : int
        Most samples of a frame, 1 to 4096.
    channels : tuple of Channel
        1 to 64 channels with distinct names.
    layer : ElasticLayer
        Rubber at the wrist.
    bytes_per_sample : int
        4 (float32) or 8 (float64).
    group_delay_ns : int
        Delay of the pulse by the sensing chain, 0 to 10 s.
    """

    name: Name
    period_ns: Annotated[int, Field(strict=True, ge=1_000, le=10 * SECOND_NS)]
    batch: Annotated[int, Field(strict=True, ge=1, le=4096)]
    channels: Annotated[
        tuple[Channel, ...], Field(min_length=1, max_length=64), AfterValidator(_distinct)
    ]
    layer: ElasticLayer
    bytes_per_sample: Literal[4, 8] = 4
    group_delay_ns: Annotated[int, Field(strict=True, ge=0, le=10 * SECOND_NS)] = 0

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return SECOND_NS / self.period_ns

    @property
    def announcing(self) -> int | None:
        """Number of the first channel that announces the beats; None without one."""
        found = (number for number, each in enumerate(self.channels) if each.announces)
        return next(found, None)

    @property
    def first_force(self) -> int:
        """Number of the first channel in N; 0 without one."""
        found = (number for number, each in enumerate(self.channels) if each.unit == "N")
        return next(found, 0)

    def find(self, channel: int | str) -> int:
        """Return the number of a channel, from its name or number.

        Raises WireError with the cause "channel" where the stream has no such channel.
        """
        names = [each.name for each in self.channels]
        if channel in names:
            return names.index(str(channel))
        if isinstance(channel, int) and channel < len(names):
            return channel
        raise WireError("channel", f"the stream has no channel {channel!r}; it has {names}")

    def find_force(self, channel: int | str) -> int:
        """Return the number of a channel that a contactor can play. Raises WireError as `find`."""
        number = self.find(channel)
        found = self.channels[number]
        if found.unit != "N":
            raise WireError("channel", f"channel {found.name!r} is in {found.unit}, no force in N")
        return number

    def to_wire(self) -> dict[str, Any]:
        """Return the description as plain types for msgpack."""
        return dataclasses.asdict(self)


_ADAPTER = TypeAdapter(StreamDescription)


def description_from_wire(table: object) -> StreamDescription:
    """Validate a received description. Raises WireError with the cause "description"."""
    try:
        return _ADAPTER.validate_python(table)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise WireError("description", f"stream description: {place}: {first['msg']}") from None


class LayerTable(Section):
    """The `layer` table of a scene: the rubber of one side (Table 3)."""

    young_modulus_pa: Annotated[Pascals, Field(gt=0)] = 0.05e9
    thickness_m: Annotated[Metres, Field(gt=0)] = 2e-3
    poisson_ratio: Annotated[float, Field(ge=0, le=0.5)] = 0.5
    contact_length_m: Annotated[Metres, Field(gt=0)] = 1.0

    def layer(self) -> ElasticLayer:
        """Return the layer that the table describes."""
        return ElasticLayer(**self.model_dump())
