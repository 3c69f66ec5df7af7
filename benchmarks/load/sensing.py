"""The sensing node under load: its own code, with a source of any number of channels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.host.process import stop_on_signals
from protocol.security.link_keys import ServerKeys
from protocol.tactile import ElasticLayer
from protocol.wire.description import Channel, StreamDescription
from sensing_node.node import SensingNode
from sensing_node.sources.source import SampleSource
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource


@dataclass(frozen=True, slots=True)
class Stream:
    """A stream at 1 kHz. batch: samples a frame."""

    batch: int = 1
    channels: int = 1


class Array(SampleSource):
    """An array of films with the same pulse."""

    def __init__(self, channels: int) -> None:
        self._pulse = SyntheticSource(SyntheticScene(kind="synthetic"))
        self.period_ns = self._pulse.period_ns
        self.channels = tuple(Channel(f"film {number}") for number in range(channels))

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next samples, shape (count, channels)."""
        return np.repeat(self._pulse.take(count), len(self.channels), axis=1)


def sense(stream: Stream, address: str, keys: ServerKeys | None = None) -> None:
    """Stream until SIGTERM."""
    source = Array(stream.channels)
    description = StreamDescription(
        "load", source.period_ns, stream.batch, source.channels, ElasticLayer()
    )
    node = SensingNode(source, description, address, keys=keys)
    stop_on_signals(node.stop)
    node.run()
