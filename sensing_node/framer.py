"""Samples into frames: numbers every sample of a session and cuts blocks into batches."""

import numpy as np

from protocol.wire.messages import Frame
from protocol.wire.stream import StreamDescription
from sensing_node.sources import SampleBlock


class Framer:
    """Cuts the blocks of one session into frames of at most `batch` samples.

    samples_sent: of the session so far; with those that a live sensor took and that never came.
    """

    def __init__(self, description: StreamDescription, session: int) -> None:
        self._session = session
        self._batch = description.batch
        self._dtype = np.dtype(f"<f{description.bytes_per_sample}")
        self.samples_sent = 0

    def frames(self, block: SampleBlock) -> list[Frame]:
        """Yield the block's samples as frames, in order."""
        self.samples_sent += block.missing
        values = block.values.astype(self._dtype)
        frames = []
        for start in range(0, len(values), self._batch):
            part = values[start : start + self._batch]
            frames.append(
                Frame(
                    session=self._session,
                    first_sample=self.samples_sent,
                    t_first_ns=block.t_first_ns + start * block.period_ns,
                    period_ns=block.period_ns,
                    values=part,
                )
            )
            self.samples_sent += len(part)
        return frames
