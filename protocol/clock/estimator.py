"""Clock offset and skew between two hosts, from four-timestamp exchanges.

Offset is remote minus local clock. The estimate follows in five steps:

1. Exchanges are grouped into blocks of 16 (`block_offset`). With exponential delays, the shortest
   exchanges carry most information; with Gaussian ones, all carry the same. So a block has one
   offset for each of five levels, from its 1, 2, 4, 8 or 16 shortest delays of each direction.
2. For each level a line is fitted through the blocks' offsets (`fit_lines`). Blocks
   with unusual round trips get a low weight.
3. One-way messages add an estimate of the skew, used where it agrees with that of the exchanges
   (`OneWaySkew`).
4. The level whose line has the smallest error is used. A level that contradicts that of the
   shortest delays has a bias, which counts as an error.
5. The result is bounded: no delay is negative, so half the shortest round trip bounds the offset.

A step of a clock is detected within an exchange or a block, and the estimate starts again.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.clock.one_way import MAX_SKEW, OffsetRegression, OneWaySkew, contradiction, fit_lines

# Exchanges of a block.
BLOCK: Final = 16
# Numbers of shortest delays of each direction from which a block's offset is computed.
LEVELS = (1, 2, 4, 8, BLOCK)
_COUNTS = np.array(LEVELS)
# Sign of a skew's effect on the delays to the remote clock, and back.
_SKEW_SIGNS = np.array([[1.0], [-1.0]])

KEEP_BLOCKS: Final = 256
READY_AFTER: Final = 3
# Smallest assumed error of a measured time.
LEAST_NOISE_NS: Final = 2_000.0
# Standard deviation of computers' skews; a larger value within a few seconds is jitter.
USUAL_SKEW: Final = 200e-6
# Number of consecutive exchanges, or blocks, that must contradict the estimate.
STEP_AFTER: Final = 3
# Smaller steps are not detected. Their effect ends when the blocks before the step are dropped.
STEP_LEAST_NS: Final = 1_000_000
STEP_NOISES: Final = 8.0
# From this number of blocks on, each new block is compared with the fitted line.
STEADY_BLOCKS: Final = 8
# Quantiles of the blocks' round trips and noises that serve as references.
SHORT, RATHER_SHORT = 0.1, 0.3
# With exponential delays in one direction only, the bias of a block's shortest delay is this share
# of the mean's bias.
UNSEEN_SHARE: Final = 1 / (BLOCK - 1)
# Weights of errors and biases, chosen for a coverage of 95 %
# (docs/decisions/0015-clock-estimator-adapts-to-jitter.md).
ERRORS, BIASES = 2.0, 1.5
# Largest error of the skew, in standard errors. Before any fit that is 600 ppm; clocks reach 500.
SKEW_ERRORS: Final = 3.0
# Two skews agree within AGREE standard errors; the excess, times DISAGREE, counts as an error.
AGREE, DISAGREE = 2.0, 2.0

# A float of this size has no fraction, so adding and subtracting it rounds to the nearest whole
# number, and half to even, below 2^51.
WHOLE: Final = 1.5 * 2.0**52

Blocks = NDArray[np.void]
# t_ns: middle of a block of exchanges on the local clock. offset_ns, round_trip_ns: for each of
# `LEVELS`, computed from the means of the shortest delays of each direction. noise_ns: standard
# error of the mean of all offsets, estimated from the shortest round trips.
_BLOCK = np.dtype(
    [
        ("t_ns", float),
        ("offset_ns", float, len(LEVELS)),
        ("round_trip_ns", float, len(LEVELS)),
        ("noise_ns", float),
    ]
)


class ClockExchange(NamedTuple):
    """The four timestamps of a request and its reply, in ns.

    The request leaves at t1 (local clock) and arrives at t2 (remote clock); the reply leaves at t3
    (remote clock) and arrives at t4 (local clock).
    """

    t1_ns: int
    t2_ns: int
    t3_ns: int
    t4_ns: int

    @property
    def offset_ns(self) -> int:
        """Remote minus local clock, assuming equal delays of both directions."""
        return (self.t2_ns - self.t1_ns + self.t3_ns - self.t4_ns) // 2

    @property
    def round_trip_ns(self) -> int:
        """Time on the network, both directions."""
        return (self.t4_ns - self.t1_ns) - (self.t3_ns - self.t2_ns)


def block_offset(
    exchanges: list[ClockExchange], origin: ClockExchange, skew: float, skew_error: float
) -> np.void:
    """Combine 1 to `BLOCK` exchanges into a block, with the fields of `_BLOCK`.

    Parameters
    ----------
    exchanges : list of ClockExchange
        The block's exchanges.
    origin : ClockExchange
        Times count from its t4, offsets from its offset.
    skew, skew_error : float
        Present estimate of remote over local clock rate, less 1, and its possible error. The skew
        is removed from the delays, so that they can be ordered. The error is added to the round
        trips, which it may have shortened.
    """
    count = len(exchanges)
    # Differences of integers first: they are exact as floats, whatever the clocks show.
    origin_ns, zero_ns = origin.t4_ns, origin.offset_ns
    rows = [
        (t1_ns + t4_ns - 2 * origin_ns, t2_ns - t1_ns - zero_ns, t4_ns - t3_ns + zero_ns)
        for t1_ns, t2_ns, t3_ns, t4_ns in exchanges
    ]
    table = np.array(rows, dtype=float).T
    t_ns = table[0] / 2
    middle_ns = float(t_ns.sum()) / count
    delays_ns = table[1:] - skew * (t_ns - middle_ns) * _SKEW_SIGNS
    if count > 1:
        shortest = (delays_ns[0] + delays_ns[1]).argsort()[: max(3, count // 4)]
        offsets_ns = (delays_ns[0] - delays_ns[1])[shortest] / 2
        apart_ns = offsets_ns - offsets_ns.sum() / len(offsets_ns)
        noise_ns = math.sqrt(float(apart_ns @ apart_ns) / (len(offsets_ns) - 1) / count)
    else:
        noise_ns = float(delays_ns.sum()) / 2
    counts = np.minimum(_COUNTS, count)
    delays_ns.sort(axis=1)
    there_ns, back_ns = delays_ns.cumsum(axis=1)[:, counts - 1] / counts
    hidden_ns = skew_error * float(t_ns.max() - t_ns.min())
    # The sum is below 0 only if a clock has stepped within the block.
    round_trip_ns = np.maximum(there_ns + back_ns + hidden_ns, 0)
    return np.void((middle_ns, (there_ns - back_ns) / 2, round_trip_ns, noise_ns), _BLOCK)


class ClockEstimator:
    """Estimator of a remote clock. Pure: all times are arguments, in integer ns.

    Attributes
    ----------
    ready : bool
        Whether there are enough exchanges to use the estimate.
    steps : int
        Number of steps of a clock that were detected; each starts the estimate again.
    asymmetry_bound_ns : int
        Half the shortest round trip. It bounds the offset's error if one direction always takes
        longer than the other, which no exchange can show.
    """

    def __init__(self) -> None:
        self.steps = 0
        self._blocks = np.zeros(KEEP_BLOCKS, _BLOCK)
        self._begin()

    @property
    def skew_ppm(self) -> float:
        """Remote over local clock rate, less 1, in parts per million."""
        return self._skew * 1e6

    def offset_ns(self, local_ns: int) -> int:
        """Return remote minus local clock at a local time."""
        return self._offset_ns + round(self._skew * (local_ns - self._reference_ns))

    def remote_ns(self, local_ns: int) -> int:
        """Return the remote clock at a local time."""
        # As `round`, which takes ten times as long: the sum is rounded to a whole number.
        drift_ns = self._skew * (local_ns - self._reference_ns) + WHOLE - WHOLE
        return local_ns + self._offset_ns + int(drift_ns)

    def uncertainty_ns(self, local_ns: int) -> int:
        """Return a bound on the error of `offset_ns` at a local time.

        It holds with a probability of 95 % if the delays of both directions have the same
        distribution. After a change of one of them, it holds less often for about a minute. It
        grows without exchanges.
        """
        since_ns = max(0, local_ns - self._reference_ns)
        return self._uncertainty_ns + round(ERRORS * self._skew_error * since_ns)

    def add(self, exchange: ClockExchange) -> bool:
        """Add an exchange; return False for one that is impossible (negative durations).

        An exchange that contradicts the estimate is not used. After three in a row, a clock has
        stepped, and the estimate starts again with them.
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

    def add_one_way(self, sent_ns: int, arrived_ns: int) -> None:
        """Add a message by the remote time at which it was sent and its local arrival."""
        if self.ready:
            self._one_way.add(sent_ns, arrived_ns, self._skew)

    def _begin(self) -> None:
        self._taken, self.ready = 0, False
        self._one_way = OneWaySkew()
        # Complete blocks at the beginning of self._blocks; self._block is the next one.
        self._known = 0
        self._block: list[ClockExchange] = []
        self._against: list[ClockExchange] = []
        self._against_blocks = 0
        self._reference_ns = self._offset_ns = self._uncertainty_ns = 0
        self._skew, self._skew_error = 0.0, USUAL_SKEW
        self.asymmetry_bound_ns = 0

    def _contradicts(self, exchange: ClockExchange) -> bool:
        error_ns = abs(exchange.offset_ns - self.offset_ns(exchange.t4_ns))
        allowed_ns = exchange.round_trip_ns // 2 + self.uncertainty_ns(exchange.t4_ns)
        return error_ns > allowed_ns + self.asymmetry_bound_ns + STEP_LEAST_NS

    def _take(self, exchange: ClockExchange) -> None:
        if not self._taken:
            self._origin = exchange
        self._taken += 1
        self.ready = self._taken >= READY_AFTER
        self._block.append(exchange)
        whole = len(self._block) == BLOCK
        # The first block is used from its first exchange on.
        if not whole and self._known:
            return
        block = block_offset(self._block, self._origin, self._skew, SKEW_ERRORS * self._skew_error)
        if self._known >= STEADY_BLOCKS:
            self._detect_step(block)
        if self._known == KEEP_BLOCKS:
            self._drop_before(1)
        self._blocks[self._known] = block
        self._fit(self._blocks[: self._known + 1], exchange.t4_ns)
        if whole:
            self._known += 1
            self._block = []

    def _detect_step(self, block: np.void) -> None:
        """Drop the earlier blocks if the last ones are off the line by more than noise explains."""
        level = self._level
        since_ns = self._reference_ns - self._origin.t4_ns - block["t_ns"]
        line_ns = self._offset_ns - self._origin.offset_ns - self._skew * since_ns
        longer_ns = abs(block["round_trip_ns"][level] - self._short_ns[level])
        allowed_ns = longer_ns / 2 + STEP_NOISES * self._noise_ns + STEP_LEAST_NS
        contradicts = abs(block["offset_ns"][level] - line_ns) > allowed_ns
        self._against_blocks = self._against_blocks + 1 if contradicts else 0
        if self._against_blocks == STEP_AFTER:
            # The first of them may span the step.
            self._drop_before(self._known - STEP_AFTER + 2)
            self._against_blocks = 0
            self._one_way = OneWaySkew()
            self.steps += 1

    def _drop_before(self, first: int) -> None:
        kept = self._known - first
        self._blocks[:kept] = self._blocks[first : self._known]
        self._known = kept

    def _fit(self, blocks: Blocks, now_ns: int) -> None:
        """Fit a line for each level, and select one."""
        round_trip_ns = blocks["round_trip_ns"]
        last = len(blocks) - 1
        short, rather_short = int(SHORT * last), int(RATHER_SHORT * last)
        ordered_ns = np.sort(round_trip_ns, axis=0)
        self._short_ns = ordered_ns[short]
        self._noise_ns = LEAST_NOISE_NS + float(np.sort(blocks["noise_ns"])[rather_short])
        usual_ns = ordered_ns[rather_short] - self._short_ns + 2 * self._noise_ns
        # Longer and shorter round trips alike belong to another route.
        weight = 1 / (1 + ((round_trip_ns - self._short_ns) / (3 * usual_ns)) ** 2)
        lines = fit_lines(blocks["t_ns"], blocks["offset_ns"], weight, self._noise_ns, USUAL_SKEW)
        self._select(_with_one_way_skew(lines, self._one_way), len(blocks), now_ns)
        self._bound(blocks)

    def _select(self, lines: OffsetRegression, blocks: int, now_ns: int) -> None:
        """Select the level with the smallest error now."""
        since_ns = float(now_ns - self._origin.t4_ns)
        offset_ns = lines.at(since_ns)
        # The scatter of few blocks is itself uncertain.
        error_ns = lines.error_at(since_ns) * (1 + 4 / blocks)
        # Delays may vary more in one direction than in the other.
        apart_ns = contradiction(offset_ns, error_ns)
        bias_ns = apart_ns + UNSEEN_SHARE * apart_ns[-1]
        # In whole ns: levels of one block differ by rounding alone, which must not decide.
        level = int(np.argmin(np.rint(error_ns + bias_ns)))
        self._level, self._reference_ns = level, now_ns
        self._offset_ns = self._origin.offset_ns + round(float(offset_ns[level]))
        self._skew = min(max(float(lines.skew[level]), -MAX_SKEW), MAX_SKEW)
        self._skew_error = float(lines.skew_error[level])
        self._uncertainty_ns = math.ceil(ERRORS * error_ns[level] + BIASES * bias_ns[level])

    def _bound(self, blocks: Blocks) -> None:
        """Bound the offset by the shortest round trip, since no delay is negative."""
        shortest = blocks[int(np.argmin(blocks["round_trip_ns"][:, 0]))]
        self.asymmetry_bound_ns = math.ceil(shortest["round_trip_ns"][0] / 2)
        since_ns = self._reference_ns - self._origin.t4_ns - float(shortest["t_ns"])
        middle_ns = round(float(shortest["offset_ns"][0]) + self._skew * since_ns)
        middle_ns += self._origin.offset_ns
        bound_ns = self.asymmetry_bound_ns + round(ERRORS * self._skew_error * abs(since_ns))
        self._offset_ns = min(max(self._offset_ns, middle_ns - bound_ns), middle_ns + bound_ns)
        # The scatter of a single block does not show a stall that affects all of it.
        certain_ns = bound_ns if len(blocks) == 1 else 0
        self._uncertainty_ns = min(max(self._uncertainty_ns, certain_ns), 2 * bound_ns)


def _with_one_way_skew(lines: OffsetRegression, one_way: OneWaySkew) -> OffsetRegression:
    """Return the lines with the weighted mean of their skew and that of one-way messages.

    Where the two disagree, the one-way delay has drifted, and gets a low weight.
    """
    if math.isinf(one_way.error):
        return lines
    apart = np.abs(lines.skew - one_way.skew)
    beyond = np.maximum(apart - AGREE * np.hypot(lines.skew_error, one_way.error), 0)
    variance = lines.skew_error**2
    share = variance / (variance + (one_way.error + DISAGREE * beyond) ** 2)
    skew = lines.skew + share * (one_way.skew - lines.skew)
    return lines._replace(skew=skew, skew_error=lines.skew_error * np.sqrt(1 - share))
