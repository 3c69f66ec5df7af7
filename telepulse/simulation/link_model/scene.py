"""The [link] section of a scene, in the file and on the command line."""

from collections.abc import Iterator
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from protocol.config.quantities import BitsPerSecond, Nanoseconds, Ratio
from protocol.config.scene import Section, validate
from protocol.errors import SceneError

Duration = Annotated[Nanoseconds, Field(ge=0, le=10_000_000_000)]
SpellLength = Annotated[Nanoseconds, Field(gt=0, le=10_000_000_000)]
Moment = Annotated[Nanoseconds, Field(ge=0, le=86_400_000_000_000)]
Share = Annotated[Ratio, Field(gt=0, lt=1)]


class BurstLoss(Section):
    """Loss in bursts (Gilbert-Elliott): for `share` of the time, and `length` on average each
    time, nothing comes through."""

    share: Share
    length_ns: SpellLength


class Reorder(Section):
    """`share` of the packets take a way that is longer by `by`: later ones overtake them."""

    share: Share
    by_ns: SpellLength


class RouteChange(Section):
    """At `at` of the link's time, the delay grows by `by`."""

    at_ns: Moment
    by_ns: Annotated[Nanoseconds, Field(ge=-10_000_000_000, le=10_000_000_000)]


class Cut(Section):
    """At `from` of the link's time, nothing comes through `for` so long."""

    from_ns: Moment
    for_ns: Moment


class LinkScene(Section):
    """What a link does to what is sent over it.

    jitter: standard deviation of the delay, whatever its kind; a delay is never below 0.
    "gaussian" goes both ways, "pareto" (a heavy tail) and "bursts" (the link stands still, then
    all comes at once) only make later. loss: share of packets that vanish at random. rate: what
    the link can carry; what would wait in its queue for too long is lost. Times count from when
    the link begins, in the simulation half a second before the stream. transport: what messages
    are in a simulation, "datagram"s that are lost and overtake one another, or a "tcp" stream.
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
    transport: Literal["datagram", "tcp"] = "datagram"

    @model_validator(mode="after")
    def _come_through(self) -> Self:
        if self.transport == "tcp" and self.loss == 1:
            raise ValueError("over tcp nothing ever arrives where loss is 1; give less, or a cut")
        return self

    def text(self) -> str:
        """The link as `parse_link` reads it."""
        return ",".join(_written(self))


def parse_link(text: str) -> LinkScene:
    """A link as a command line has it: "delay=40ms,loss=1%,cut.from=3s,cut.for=2s".

    Raises SceneError.
    """
    table: dict[str, Any] = {}
    for part in filter(None, text.split(",")):
        key, _, value = part.partition("=")
        name, dot, inner = key.strip().partition(".")
        known = table.setdefault(name, {} if dot else "")
        if isinstance(known, dict) != bool(dot):
            raise SceneError(f"--link {text!r}: {name} is given as a table and as a value")
        if dot:
            known[inner] = value.strip()
        else:
            table[name] = value.strip()
    return validate(table, LinkScene, where=f"--link {text!r}:")


def _written(section: Section, prefix: str = "") -> Iterator[str]:
    for name, field in type(section).model_fields.items():
        key, value = prefix + (field.alias or name), getattr(section, name)
        if isinstance(value, Section):
            yield from _written(value, key + ".")
        elif value is not None:
            unit = "ns" if name.endswith("_ns") else "bit/s" if name.endswith("_bit_per_s") else ""
            yield f"{key}={value}{unit}"
