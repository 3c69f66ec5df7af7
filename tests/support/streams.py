"""A stream, its frames and a source, for tests."""

import numpy as np
import pytest

from display_node.reception.jitter_buffer import JitterBuffer
from protocol.errors import WireError
from protocol.tactile import ElasticLayer
from protocol.wire.description import Channel, StreamDescription
from protocol.wire.messages import ChannelSamples, Frame
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource

MS = 1_000_000
T0_NS = 1_700_000_000_000_000_000


def description(**changes: object) -> StreamDescription:
    fields: dict[str, object] = {
        "name": "test pulse",
        "period_ns": MS,
        "batch": 5,
        "channels": (Channel("pulse"),),
        "layer": ElasticLayer(),
    }
    return StreamDescription(**(fields | changes))


def synthetic(**keys: object) -> SyntheticSource:
    """Return a synthetic source with keys of a scene's table."""
    return SyntheticSource(SyntheticScene.model_validate({"kind": "synthetic"} | keys))


def at_ns(sample: float) -> int:
    return T0_NS + round(sample * MS)


def frame(first: int, count: int = 5, shift_ns: int = 0) -> Frame:
    """Return samples at 1 kHz, of which each value is half its number."""
    values = 0.5 * np.arange(first, first + count, dtype=float)[:, np.newaxis]
    return Frame(1, first, at_ns(first) + shift_ns, MS, values)


def samples(first: int, count: int = 5, shift_ns: int = 0) -> ChannelSamples:
    return frame(first, count, shift_ns).samples_of(0)


def put(buffer: JitterBuffer, frame: ChannelSamples) -> None:
    """Put a frame of one channel into a buffer."""
    buffer.put(frame.first_sample, frame.period_ns, frame.times_ns, [frame.forces_n])


def filled(*frames: ChannelSamples) -> JitterBuffer:
    buffer = JitterBuffer()
    for each in frames:
        put(buffer, each)
    return buffer


def refusal(buffer: JitterBuffer, refused: ChannelSamples) -> str:
    with pytest.raises(WireError) as caught:
        put(buffer, refused)
    return caught.value.cause
