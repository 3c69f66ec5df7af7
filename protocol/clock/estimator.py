"""Clock offset and skew between two hosts, from four-timestamp exchanges.

Offset is remote minus local. Which exchanges tell most depends on the jitter: with exponential
delays the shortest, with Gaussian ones all alike. So exchanges are taken in blocks, each block's
offset is computed from few and from many of its shortest delays (`exchanges.py`), a line is drawn
through the blocks for each of these levels, and the level is used whose blocks scatter least about
their line and which does not contradict the shortest delays. Messages that come one way
add what they say of the skew, where it agrees (`skew.py`).
"""

import math

import numpy as np
from numpy.typing import NDArray

from protocol.clock.exchanges import BLOCK, LEVELS, BlockOffset, ClockExchange, block_offset
from protocol.clock.offset_regression import Floats, OffsetRegression, fit_lines
from protocol.clock.skew import MAX_SKEW, OneWaySkew

__all__ = ["ClockEstimator", "ClockExchange"]

KEEP_BLOCKS = 256
READY_AFTER = 3
# Nothing is timed better than this.
LEAST_NOISE_NS = 2_000.0
# Clocks of computers run alike to about this; what a few seconds seem to say beyond it is jitter.
USUAL_SKEW = 200e-6
# So many exchanges, or blocks, in a row have to contradict the estimate.
STEP_AFTER = 3
# A smaller step is none: it leaves the memory in time.
STEP_LEAST_NS = 1_000_000
STEP_NOISES = 8.0
# Before so many blocks are known, none contradicts them.
STEADY_BLOCKS = 8
# Blocks are compared with the better ones of them: at these shares, in order.
SHORT, RATHER_SHORT = 0.1, 0.3
# Exponential delays on one way alone put the shortest of a block off by this share of what they
# put the mean off.
UNSEEN_SHARE = 1 / (BLOCK - 1)
# Chosen for 95 of 100 (docs/decisions/0015-the-clock-weighs-delays-by-their-scatter.md).
ERRORS, BIASES = 2.0, 1.5
# In standard errors: a skew of 500 ppm is not unheard of.
SKEW_DOUBT = 3.0
# Two skews agree within so many standard errors; what is beyond counts so many times as error.
AGREE, DISAGREE = 2.0, 2.0

Blocks = NDArray[np.void]
_MEMORY = np.dtype(
    [
        ("t_ns", float),
        ("offset_ns", float, len(LEVELS)),
        ("round_trip_ns", float, len(LEVELS)),
        ("noise_ns", float),
    ]
)


class ClockEstimator:
    """Follows a remote clock. Pure: local times come in with the exchanges and the questions.

    steps: how often one of the clocks has jumped; the estimate then starts afresh.
    asymmetry_bound_ns: half the shortest round trip; one way that always takes longer than the
    other, which no exchange can tell, puts the offset off by no more.
    """

    def __init__(self) -> None:
        self.steps = 0
        self._blocks = np.zeros(KEEP_BLOCKS, _MEMORY)
        self._begin()

    @property
    def ready(self) -> bool:
        """Enough exchanges have come to use the estimate."""
        return self._taken >= READY_AFTER

    @property
    def skew_ppm(self) -> float:
        """How much faster the remote clock runs, in parts per million."""
        return self._skew * 1e6

    def offset_ns(self, local_ns: int) -> int:
        """Remote minus local clock at a local time."""
        return self._offset_ns + round(self._skew * (local_ns - self._reference_ns))

    def remote_ns(self, local_ns: int) -> int:
        """The remote clock at a local time."""
        return local_ns + self.offset_ns(local_ns)

    def uncertainty_ns(self, local_ns: int) -> int:
        """How far off `offset_ns` may be, about 95 times of 100 where the ways are alike but for
        chance, and seldom for a minute after one of them has changed; grows while no
        exchanges come."""
        since_ns = max(0, local_ns - self._reference_ns)
        return self._uncertainty_ns + round(ERRORS * self._skew_error * since_ns)

    def add(self, exchange: ClockExchange) -> bool:
        """Take an exchange; False when it is refused because it cannot be (negative times).

        One that contradicts the estimate is set aside, until enough of them in a row say that
        a clock has stepped: then the estimate starts afresh with them.
        """
        if exchange.round_trip_ns < 0 or exchange.t3_ns < exchange.t2_ns:
            return False
        if not (self.ready and self._contradicts(exchange)):
            self._against.clear()
            self._take(exchange)
            return True
        self._against.append(exchange)
        if len(self._against) == STEP_AFTER:
            against = self._against
            self._begin()
            self.steps += 1
            for each in against:
                self._take(each)
        return True

    def hear(self, sent_ns: int, arrived_ns: int) -> None:
        """A message that was sent at a time of the remote clock has come, at a local time."""
        if self.ready:
            self._one_way.hear(sent_ns, arrived_ns, self._skew)

    def _begin(self) -> None:
        self._taken = 0
        self._one_way = OneWaySkew()
        # Whole blocks, at the beginning of self._blocks; self._block is the next one.
        self._known = 0
        self._block: list[ClockExchange] = []
        self._against: list[ClockExchange] = []
        self._against_blocks = 0
        self._reference_ns = self._offset_ns = self._uncertainty_ns = 0
        self._skew, self._skew_error = 0.0, USUAL_SKEW
        self.asymmetry_bound_ns = 0

    def _contradicts(self, exchange: ClockExchange) -> bool:
        """The exchange and the estimate are further apart than both can be wrong."""
        error_ns = abs(exchange.offset_ns - self.offset_ns(exchange.t4_ns))
        allowed_ns = exchange.round_trip_ns // 2 + self.uncertainty_ns(exchange.t4_ns)
        return error_ns > allowed_ns + self.asymmetry_bound_ns + STEP_LEAST_NS

    def _take(self, exchange: ClockExchange) -> None:
        if not self._taken:
            self._origin = exchange
        self._taken += 1
        self._block.append(exchange)
        whole = len(self._block) == BLOCK
        # The first block counts from its first exchange on.
        if not whole and self._known:
            return
        block = block_offset(self._block, self._origin, self._skew, SKEW_DOUBT * self._skew_error)
        if self._known >= STEADY_BLOCKS:
            self._look_for_a_step(block)
        if self._known == KEEP_BLOCKS:
            self._forget_before(1)
        self._blocks[self._known] = block
        self._draw(self._blocks[: self._known + 1], exchange.t4_ns)
        if whole:
            self._known += 1
            self._block = []

    def _look_for_a_step(self, block: BlockOffset) -> None:
        """Keep the last blocks alone when they all are further off the line than chance and a
        change of the round trip explain."""
        level = self._level
        since_ns = self._reference_ns - self._origin.t4_ns - block.t_ns
        line_ns = self._offset_ns - self._origin.offset_ns - self._skew * since_ns
        longer_ns = abs(block.round_trip_ns[level] - self._short_ns[level])
        allowed_ns = longer_ns / 2 + STEP_NOISES * self._noise_ns + STEP_LEAST_NS
        contradicts = abs(block.offset_ns[level] - line_ns) > allowed_ns
        self._against_blocks = self._against_blocks + 1 if contradicts else 0
        if self._against_blocks == STEP_AFTER:
            # The first of them may lie on both sides of the step.
            self._forget_before(self._known - STEP_AFTER + 2)
            self._against_blocks = 0
            self._one_way = OneWaySkew()
            self.steps += 1

    def _forget_before(self, first: int) -> None:
        kept = self._known - first
        self._blocks[:kept] = self._blocks[first : self._known]
        self._known = kept

    def _draw(self, blocks: Blocks, now_ns: int) -> None:
        """Draw a line for each level through the blocks, and use one."""
        round_trip_ns = blocks["round_trip_ns"]
        last = len(blocks) - 1
        short, rather_short = int(SHORT * last), int(RATHER_SHORT * last)
        ordered_ns = np.sort(round_trip_ns, axis=0)
        self._short_ns = ordered_ns[short]
        self._noise_ns = LEAST_NOISE_NS + float(np.sort(blocks["noise_ns"])[rather_short])
        usual_ns = ordered_ns[rather_short] - self._short_ns + 2 * self._noise_ns
        # Round trips of another length, be they longer or shorter, are of another route.
        weight = 1 / (1 + ((round_trip_ns - self._short_ns) / (3 * usual_ns)) ** 2)
        lines = fit_lines(blocks["t_ns"], blocks["offset_ns"], weight, self._noise_ns, USUAL_SKEW)
        self._use(_joined(lines, self._one_way), len(blocks), now_ns)
        self._bound(blocks)

    def _use(self, lines: OffsetRegression, blocks: int, now_ns: int) -> None:
        """Take the line that is best now."""
        since_ns = float(now_ns - self._origin.t4_ns)
        offset_ns = lines.at(since_ns)
        # Few blocks say little of how much they scatter.
        error_ns = lines.error_at(since_ns) * (1 + 4 / blocks)
        bias_ns = _bias_ns(offset_ns, error_ns)
        level = int(np.argmin(error_ns + bias_ns))
        self._level, self._reference_ns = level, now_ns
        self._offset_ns = self._origin.offset_ns + round(float(offset_ns[level]))
        self._skew = min(max(float(lines.skew[level]), -MAX_SKEW), MAX_SKEW)
        self._skew_error = float(lines.skew_error[level])
        self._uncertainty_ns = math.ceil(ERRORS * error_ns[level] + BIASES * bias_ns[level])

    def _bound(self, blocks: Blocks) -> None:
        """Whatever the line says: no delay is below 0, so the shortest round trip bounds the
        offset."""
        shortest = blocks[int(np.argmin(blocks["round_trip_ns"][:, 0]))]
        self.asymmetry_bound_ns = math.ceil(shortest["round_trip_ns"][0] / 2)
        since_ns = self._reference_ns - self._origin.t4_ns - float(shortest["t_ns"])
        middle_ns = round(float(shortest["offset_ns"][0]) + self._skew * since_ns)
        middle_ns += self._origin.offset_ns
        bound_ns = self.asymmetry_bound_ns + round(ERRORS * self._skew_error * abs(since_ns))
        self._offset_ns = min(max(self._offset_ns, middle_ns - bound_ns), middle_ns + bound_ns)
        # One block may have met one stall, and then says nothing of its own error.
        certain_ns = bound_ns if len(blocks) == 1 else 0
        self._uncertainty_ns = min(max(self._uncertainty_ns, certain_ns), 2 * bound_ns)


def _joined(lines: OffsetRegression, one_way: OneWaySkew) -> OffsetRegression:
    """The lines with the skew that the exchanges and the messages of one way say together.

    Where they disagree, the one way has become longer or shorter, and counts little.
    """
    if math.isinf(one_way.error):
        return lines
    apart = np.abs(lines.skew - one_way.skew)
    beyond = np.maximum(apart - AGREE * np.hypot(lines.skew_error, one_way.error), 0)
    variance = lines.skew_error**2
    share = variance / (variance + (one_way.error + DISAGREE * beyond) ** 2)
    return lines._replace(
        skew=lines.skew + share * (one_way.skew - lines.skew),
        skew_error=lines.skew_error * np.sqrt(1 - share),
    )


def _bias_ns(offset_ns: Floats, error_ns: Floats) -> Floats:
    """By how much each level is off where delays vary more on one way than on the other.

    Then the levels differ from that of the shortest delays beyond their errors.
    """
    apart_ns = np.abs(offset_ns - offset_ns[0]) - 2 * np.hypot(error_ns, error_ns[0])
    bias_ns: Floats = np.maximum(apart_ns, 0) + UNSEEN_SHARE * max(float(apart_ns[-1]), 0)
    return bias_ns
