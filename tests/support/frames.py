"""Frames for a jitter buffer in tests."""

import numpy as np
import pytest

from display_node.reception.jitter_buffer import JitterBuffer
from protocol.errors import WireError
from protocol.wire.messages import Frame

MS = 1_000_000
T0_NS = 1_700_000_000_000_000_000


def at_ns(sample: float) -> int:
    return T0_NS + round(sample * MS)


def frame(first: int, count: int = 5, shift_ns: int = 0) -> Frame:
    """Samples of 1 kHz whose values are their own numbers, halved."""
    values = 0.5 * np.arange(first, first + count, dtype=float)[:, np.newaxis]
    return Frame(1, first, at_ns(first) + shift_ns, MS, values)


def filled(*frames: Frame) -> JitterBuffer:
    buffer = JitterBuffer(0)
    for each in frames:
        buffer.put(each)
    return buffer


def refusal(buffer: JitterBuffer, refused: Frame) -> str:
    with pytest.raises(WireError) as caught:
        buffer.put(refused)
    return caught.value.cause
