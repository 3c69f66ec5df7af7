"""Four-timestamp exchanges, and what a block of them says about the offset of two clocks."""

import math
from typing import NamedTuple

import numpy as np

from protocol.clock.offset_regression import Floats

BLOCK = 16
# An offset is computed from the so many shortest delays of each way, by turns.
LEVELS = (1, 2, 4, 8, BLOCK)
_COUNTS = np.array(LEVELS)
# What a skew adds to the delays of each way.
_THERE_AND_BACK = np.array([[1.0], [-1.0]])


class ClockExchange(NamedTuple):
    """t1: request leaves (local clock); t2: it arrives, t3: reply leaves (remote clock);
    t4: reply arrives (local clock); all ns."""

    t1_ns: int
    t2_ns: int
    t3_ns: int
    t4_ns: int

    @property
    def offset_ns(self) -> int:
        """Remote minus local clock, if both ways took equally long."""
        return (self.t2_ns - self.t1_ns + self.t3_ns - self.t4_ns) // 2

    @property
    def round_trip_ns(self) -> int:
        """Time on the network, both ways."""
        return (self.t4_ns - self.t1_ns) - (self.t3_ns - self.t2_ns)


class BlockOffset(NamedTuple):
    """What a block of exchanges says, for each of `LEVELS`: offset and round trip in ns, from
    the means of the shortest delays there and the shortest delays back.

    t_ns: the block's middle, local clock; noise_ns: standard error of the mean of all offsets, as
    those of the shortest round trips let expect it.
    """

    t_ns: float
    offset_ns: Floats
    round_trip_ns: Floats
    noise_ns: float


def block_offset(
    exchanges: list[ClockExchange], origin: ClockExchange, skew: float, skew_doubt: float
) -> BlockOffset:
    """Up to `BLOCK` exchanges as one; times and offsets count from `origin`'s.

    skew: the clocks', as far as known, so that the order of delays is not that of the times;
    skew_doubt: how wrong it can be. By what it may have made shorter, round trips are lengthened.
    """
    count = len(exchanges)
    # Differences of whole numbers first: they are exact as floats, whatever the clocks show.
    origin_ns, zero_ns = origin.t4_ns, origin.offset_ns
    rows = [
        (t1_ns + t4_ns - 2 * origin_ns, t2_ns - t1_ns - zero_ns, t4_ns - t3_ns + zero_ns)
        for t1_ns, t2_ns, t3_ns, t4_ns in exchanges
    ]
    table = np.array(rows, dtype=float).T
    t_ns = table[0] / 2
    middle_ns = float(t_ns.sum()) / count
    ways_ns = table[1:] - skew * (t_ns - middle_ns) * _THERE_AND_BACK
    if count > 1:
        shortest = (ways_ns[0] + ways_ns[1]).argsort()[: max(3, count // 4)]
        offsets_ns = (ways_ns[0] - ways_ns[1])[shortest] / 2
        apart_ns = offsets_ns - offsets_ns.sum() / len(offsets_ns)
        noise_ns = math.sqrt(float(apart_ns @ apart_ns) / (len(offsets_ns) - 1) / count)
    else:
        noise_ns = float(ways_ns.sum()) / 2
    counts = np.minimum(_COUNTS, count)
    ways_ns.sort(axis=1)
    there_ns, back_ns = ways_ns.cumsum(axis=1)[:, counts - 1] / counts
    hidden_ns = skew_doubt * float(t_ns.max() - t_ns.min())
    # Below 0 only where a clock has stepped within the block.
    round_trip_ns = np.maximum(there_ns + back_ns + hidden_ns, 0)
    return BlockOffset(middle_ns, (there_ns - back_ns) / 2, round_trip_ns, noise_ns)
