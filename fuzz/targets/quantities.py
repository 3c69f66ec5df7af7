"""Quantities, ratios, links and real-time measures as text."""

import math
from contextlib import suppress

from protocol.config.quantities import UNITS, in_unit_of, parse_quantity, parse_ratio
from protocol.errors import RealtimeError, SceneError
from protocol.host.realtime import MAX_PRIORITY, parse_realtime
from telepulse.simulation.link_scene import parse_link

LINKS = (
    "delay=40ms,jitter=10ms,loss=1%,jitter_kind=pareto",
    "burst_loss.share=1%,burst_loss.length=80ms,reorder.share=2%,reorder.by=5ms",
    "rate=1Mbit/s,route_change.at=3s,route_change.by=-2ms,cut.from=3s,cut.for=2s,transport=tcp",
)
MEASURES = "fifo=40,lock,cpu=2-3,cpu=0,gc,slack,strict"


def seeds() -> list[bytes]:
    """Return a quantity of each unit, and links."""
    quantities = [f"{n}.5e-{n} {unit}" for units in UNITS.values() for n, unit in enumerate(units)]
    return [text.encode() for text in (*quantities, "1 %", *LINKS, MEASURES)]


def try_one(data: bytes) -> None:
    """Parse a text; the result is finite, and a link survives its own text."""
    text = data.decode("utf-8", "replace")
    for dimension in UNITS:
        with suppress(ValueError):
            assert math.isfinite(parse_quantity(text, dimension))
    with suppress(ValueError):
        assert math.isfinite(parse_ratio(text))
    in_unit_of(1.5, text)
    with suppress(SceneError):
        link = parse_link(text)
        assert parse_link(link.text()) == link
    with suppress(RealtimeError):
        assert parse_realtime(text).fifo in (None, *range(1, MAX_PRIORITY + 1))
