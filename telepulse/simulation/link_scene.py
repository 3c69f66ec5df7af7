"""The `link` table: impairments of a link, as a table or as a text."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from protocol.config.quantities import BitsPerSecond, Nanoseconds, Ratio
from protocol.config.scene import Section, validate
from protocol.errors import SceneError

Duration = Annotated[Nanoseconds, Field(ge=0, le=10_000_000_000)]
PositiveDuration = Annotated[Nanoseconds, Field(gt=0, le=10_000_000_000)]
LinkTime = Annotated[Nanoseconds, Field(ge=0, le=86_400_000_000_000)]
Share = Annotated[Ratio, Field(gt=0, lt=1)]


class BurstLoss(Section):
    """Loss in bursts (Gilbert-Elliott).

    share: fraction of the time in a burst, in which every packet is lost. length: mean duration of
    a burst.
    """

    share: Share
    length_ns: PositiveDuration


class Reorder(Section):
    """`share` of the packets arrive later by `by`, so that later ones overtake them."""

    share: Share
    by_ns: PositiveDuration


class RouteChange(Section):
    """A change of the delay by `by`, which may be negative, at the time `at`."""

    at_ns: LinkTime
    by_ns: Annotated[Nanoseconds, Field(ge=-10_000_000_000, le=10_000_000_000)]


class Cut(Section):
    """An outage that begins at the time `from` and lasts for the time `for`."""

    from_ns: LinkTime
    for_ns: LinkTime


class Stall(Section):
    """A stall for the time `for` in each period `every`, at its end; then everything arrives."""

    for_ns: PositiveDuration
    every_ns: Annotated[Nanoseconds, Field(gt=0, le=3_600_000_000_000)]

    @model_validator(mode="after")
    def _something_passes(self) -> Self:
        if self.for_ns >= self.every_ns:
            raise ValueError("every must be longer than for, or nothing ever arrives in time")
        return self


class Wander(Section):
    """A delay that wanders by up to `by` more, and changes its direction each time `over`."""

    by_ns: PositiveDuration
    over_ns: PositiveDuration


class LinkScene(Section):
    """Impairments of a link.

    jitter: standard deviation of the delay, whatever its kind; a delay is never below 0.
    "gaussian" jitter may shorten or lengthen the delay; "pareto" (a heavy tail) and "bursts" (the
    link stalls, then everything arrives at once) only lengthen it. loss: share of packets that are
    lost at random. rate: capacity of the link; a packet that would wait in its queue for more than
    200 ms is lost. stall: the link stalls at regular times. wander: the delay wanders slowly, as in
    a mobile network. Times count from the beginning of the link; a simulation's link begins 0.5 s
    before the stream. transport: how a simulation carries messages, as "datagram"s that may be lost
    or reordered, or as a "tcp" stream.
    """

    delay_ns: Duration = 0
    jitter_ns: Duration = 0
    jitter_kind: Literal["gaussian", "pareto", "bursts"] = "gaussian"
    loss: Annotated[Ratio, Field(ge=0, le=1)] = 0.0
    burst_loss: BurstLoss | None = None
    reorder: Reorder | None = None
    rate_bit_per_s: Annotated[BitsPerSecond | None, Field(ge=1e3, le=1e10)] = None
    route_change: RouteChange | None = None
    cut: Cut | None = None
    stall: Stall | None = None
    wander: Wander | None = None
    transport: Literal["datagram", "tcp"] = "datagram"

    @model_validator(mode="after")
    def _something_arrives(self) -> Self:
        if self.transport == "tcp" and self.loss == 1:
            reason = "over tcp nothing ever arrives where loss is 1; use a loss below 1, or a cut"
            raise ValueError(reason)
        return self

    def text(self) -> str:
        """Return the link in the notation of `parse_link`."""
        return ",".join(_items(self))


def parse_link(text: str) -> LinkScene:
    """Return the link of a text such as "delay=40ms,loss=1%,cut.from=3s,cut.for=2s".

    Raises SceneError.
    """
    table: dict[str, Any] = {}
    for part in filter(None, text.split(",")):
        key, _, value = part.partition("=")
        name, dot, inner = key.strip().partition(".")
        entry = table.setdefault(name, {} if dot else "")
        if isinstance(entry, dict) != bool(dot):
            raise SceneError(f"--link {text!r}: {name} is given as a table and as a value")
        if dot:
            entry[inner] = value.strip()
        else:
            table[name] = value.strip()
    return validate(table, LinkScene, where=f"--link {text!r}:")


def _items(section: Section, prefix: str = "") -> Iterator[str]:
    for name, field in type(section).model_fields.items():
        key, value = prefix + (field.alias or name), getattr(section, name)
        if isinstance(value, Section):
            yield from _items(value, key + ".")
        elif value is not None:
            unit = "ns" if name.endswith("_ns") else "bit/s" if name.endswith("_bit_per_s") else ""
            yield f"{key}={value}{unit}"
