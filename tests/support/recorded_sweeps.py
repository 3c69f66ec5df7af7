"""A recorded sweep of the modelled wrist, as a session and as a file, without a display."""

import numpy as np
from numpy.typing import NDArray

from display_node.press.sweep import DepthSweep, SweepPlan
from protocol.tactile import ElasticLayer
from protocol.wire.description import Channel, StreamDescription
from protocol.wire.messages import Frame, encode_frame
from sensing_node.sources.wrist import Wrist, WristScene
from telepulse.recording.session import RecordedSession
from telepulse.simulation.simulated_run import BATCH, sweep_wrist

PERIOD_NS = 1_000_000


class SweptWrist(Wrist):
    """A wrist that was swept once, and the samples that were taken."""

    def __init__(self, plan: SweepPlan | None = None) -> None:
        super().__init__(WristScene.model_validate({"kind": "wrist", "noise": "0.5 mN"}))
        self.taken: list[NDArray[np.float64]] = []
        sweep_wrist(self, DepthSweep(plan or SweepPlan()), 2.5)

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next samples, and keep them."""
        self.taken.append(super().take(count))
        return self.taken[-1]


def session_of(
    taken: list[NDArray[np.float64]], channels: tuple[Channel, ...] = Wrist.channels
) -> RecordedSession:
    """Return samples as a recorded session."""
    description = StreamDescription("swept", PERIOD_NS, BATCH, channels, ElasticLayer())
    # A live node's frames differ in length.
    values, data, first = np.concatenate(taken).astype("<f4"), dict[int, bytes](), 0
    while first < len(values):
        part = values[first : first + (1 if first % 3 else BATCH)]
        frame = Frame(1, first, first * PERIOD_NS, PERIOD_NS, part)
        data[first] = encode_frame(frame)
        first += len(part)
    return RecordedSession(1, description, data, BATCH * len(taken))
