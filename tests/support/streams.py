"""A stream and a source for tests."""

from protocol.tactile import ElasticLayer
from protocol.wire.stream import Channel, StreamDescription
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource

MS = 1_000_000


def description(**changes: object) -> StreamDescription:
    fields: dict[str, object] = {
        "name": "test pulse",
        "period_ns": MS,
        "batch": 5,
        "channels": (Channel("pulse"),),
        "layer": ElasticLayer(),
    }
    return StreamDescription(**(fields | changes))  # type: ignore[arg-type]


def synthetic(**keys: object) -> SyntheticSource:
    """A synthetic source from the keys of a scene's table."""
    return SyntheticSource(SyntheticScene.model_validate({"kind": "synthetic"} | keys))
