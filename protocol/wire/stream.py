"""A stream's description: what a display must know to turn its frames into strain.

It travels in the sensing node's welcome, so a display that joins late has it too.
"""

import dataclasses
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from protocol.config.quantities import Metres, Pascals
from protocol.config.scene import Section
from protocol.errors import WireError
from protocol.tactile import ElasticLayer

MAX_NAME = 80
_STRICT = ConfigDict(extra="forbid", allow_inf_nan=False)


def _printable(name: str) -> str:
    if not name.isprintable():
        raise ValueError("holds characters that a terminal cannot show")
    return name


Name = Annotated[
    str, Field(strict=True, min_length=1, max_length=MAX_NAME), AfterValidator(_printable)
]
SECOND_NS = 1_000_000_000


@dataclass(frozen=True, slots=True, config=_STRICT)
class Channel:
    """One channel of the stream: its name and its unit."""

    name: Name
    unit: Literal["N"] = "N"


@dataclass(frozen=True, slots=True, config=_STRICT)
class StreamDescription:
    """What the frames of a stream hold.

    period_ns: time between samples. batch: samples a frame, at most. bytes_per_sample: 4 or 8
    (float32 or float64). layer: the rubber at the wrist. group_delay_ns: by how much the
    sensing chain delays the pulse.
    """

    name: Name
    period_ns: Annotated[int, Field(strict=True, ge=1_000, le=10 * SECOND_NS)]
    batch: Annotated[int, Field(strict=True, ge=1, le=4096)]
    channels: Annotated[tuple[Channel, ...], Field(min_length=1, max_length=64)]
    layer: ElasticLayer
    bytes_per_sample: Literal[4, 8] = 4
    group_delay_ns: Annotated[int, Field(strict=True, ge=0, le=10 * SECOND_NS)] = 0

    @property
    def rate_hz(self) -> float:
        """Samples a second."""
        return SECOND_NS / self.period_ns

    def to_wire(self) -> dict[str, Any]:
        """The description as plain types that msgpack carries."""
        return dataclasses.asdict(self)


_ADAPTER = TypeAdapter(StreamDescription)


def description_from_wire(table: object) -> StreamDescription:
    """Validate a description that came over the wire. Raises WireError("description")."""
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
        """The layer this table describes."""
        return ElasticLayer(**self.model_dump())
