"""Errors to expect of predicted paths, measured on the last paths once their values have come."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from display_node.prediction import DECAY_OVER_HORIZON
from display_node.prediction.expert import HORIZONS, Floats
from display_node.prediction.kernels import CUBE, FLOATS, TABLE, kernel
from protocol.tactile import JND

# Delays E after which the pulse is compared with the present one, in steps of 10 ms from 0 on.
DELAYS: Final = 26
# Steps for which paths are kept: beyond the longest horizon and the longest delay together.
KEPT: Final = 64
# Steps whose errors are kept, for those of the last beat: above the longest number of them.
ERRORS: Final = 256
# What is felt was predicted earlier by the time over which a correction is blended in.
BLENDED: Final = 1 + DECAY_OVER_HORIZON
# Squared errors are expected by those of the last 20 s. The memory grows by a fifth of a step a
# step, so that errors of the time before the predictor had learnt are soon forgotten.
MEMORY_STEPS: Final = 2_000
FIRST_STEPS: Final = 50
# Noticed errors are counted by blocks of 1 s: over the last third of the time, at most 30 s.
BLOCK_STEPS: Final = 100
BLOCKS: Final = 30
FEWEST_BLOCKS: Final = 5
# Errors during an artefact are remembered for 1 s.
ARTEFACT_STEPS: Final = 100
# Running median of half the squared change of the error 10 ms ahead, which is the variance of white
# noise: it rises or falls by so much a step, and by more in the first seconds. The median of such
# squares is so much of their mean.
MEDIAN_STEP: Final = 0.005
FIRST_MEDIAN_STEPS: Final = 20
MEDIAN_OF_SQUARES: Final = 0.4549
# A squared error, in units of the signal's variance, counts as at most this.
WORST: Final = 1e4
# First and least variance of the noise, in the same unit.
FIRST_WHITE: Final = 1e-4
LEAST_WHITE: Final = 1e-9


@dataclass(frozen=True, slots=True)
class ExpectedErrors:
    """Errors to expect of a channel's prediction, at horizons of 10, 20, … 250 ms.

    Attributes
    ----------
    squares_n2 : ndarray, shape (25,)
        Squared errors of the prediction, in N², over the last beat.
    in_phase_n2 : ndarray, shape (26, 26)
        Expected squared errors in N² of a force that is predicted over a horizon and felt after a
        delay, against the pulse at that time. By horizon from 0, which is a received force, and by
        delay from 0, in steps of 10 ms; without white noise of the sensor.
    noticed : ndarray, shape (26,)
        Expected share of the time in which the prediction is wrong by more than a finger notices,
        by horizon from 0.
    height_n : float
        Height of the pulse from foot to peak.
    """

    squares_n2: Floats
    in_phase_n2: Floats
    noticed: Floats
    height_n: float


@kernel(
    f"void({CUBE}, {CUBE}, {CUBE}, {TABLE}, {CUBE}, {TABLE}, int64, {FLOATS}, {TABLE}, {FLOATS},"
    f" {FLOATS}, {FLOATS}, float64, boolean)"
)
def add_errors(
    paths: Floats,
    in_phase: Floats,
    noticed: Floats,
    disturbed: Floats,
    sums: Floats,
    values: Floats,
    steps: int,
    newest: Floats,
    made: Floats,
    noticeable: Floats,
    white: Floats,
    last: Floats,
    keep: float,
    artefact: bool,
) -> None:
    """Judge the last paths by the newest values, and store new paths.

    paths: shape (channels, KEPT, 25), by step and horizon. in_phase: shape (channels, 26, 26).
    noticed: counts by block of time, and in the last place of each the steps that were judged,
    shape (channels, BLOCKS, 27). disturbed: shape (channels, 26). sums: of the squared errors so
    far, shape (channels, ERRORS, 26). values: the last newest values, shape (channels, KEPT).
    steps: number so far. noticeable: least squared difference of each channel that a finger
    notices. white: variance of each channel's white noise. last: error 10 ms ahead. keep: weight of
    the newest errors.
    """
    fade = 1.0 - 1.0 / ARTEFACT_STEPS
    quick = max(MEDIAN_STEP, 2.0 / (FIRST_MEDIAN_STEPS + steps))
    before, after = steps % ERRORS, (steps + 1) % ERRORS
    block = steps // BLOCK_STEPS % BLOCKS
    for channel in range(len(paths)):
        value, counts = newest[channel], noticed[channel, block]
        threshold = noticeable[channel] + white[channel]
        if steps % BLOCK_STEPS == 0:
            counts[:] = 0.0
        if not artefact:
            counts[HORIZONS + 1] += 1.0
        for horizon in range(HORIZONS + 1):
            sums[channel, after, horizon] = sums[channel, before, horizon]
            for delay in range(DELAYS):
                ago = horizon + delay
                if ago > steps or ago == 0:
                    continue
                place = (steps - ago) % KEPT
                if horizon == 0:
                    felt = values[channel, place]
                else:
                    felt = paths[channel, place, horizon - 1]
                square = (value - felt) ** 2
                # An error that is no number is the worst, too.
                square = square if square < WORST else WORST
                if horizon == 1 and delay == 0:
                    half = 0.5 * (value - felt - last[channel]) ** 2
                    last[channel] = value - felt
                    above = half > white[channel] * MEDIAN_OF_SQUARES
                    factor = 1.0 + quick if above else 1.0 - quick
                    white[channel] = max(white[channel] * factor, LEAST_WHITE)
                if delay == 0:
                    over = 1.0 if square > threshold else 0.0
                    sums[channel, after, horizon] += square
                    disturbed[channel, horizon] *= fade
                    if artefact:
                        disturbed[channel, horizon] += (1.0 - fade) * over
                    else:
                        counts[horizon] += over
                if not artefact:
                    in_phase[channel, horizon, delay] += keep * (
                        square - in_phase[channel, horizon, delay]
                    )
        values[channel, steps % KEPT] = value
        paths[channel, steps % KEPT] = made[channel]


@kernel(f"void({TABLE}, int64, int64, {FLOATS})")
def average_noticed(counts: Floats, newest: int, blocks: int, shares: Floats) -> None:
    """Write the share of the steps of the last blocks in which an error was noticed.

    The two adjacent blocks of each horizon in which it was noticed most do not count: a single
    event, such as an early beat, is no rate.
    """
    for horizon in range(HORIZONS + 1):
        total = judged = worst = worst_judged = 0.0
        last = last_judged = 0.0
        for ago in range(blocks):
            block = counts[(newest - ago) % BLOCKS]
            count, steps = block[horizon], block[HORIZONS + 1]
            total += count
            judged += steps
            if ago > 0 and count + last >= worst:
                worst, worst_judged = count + last, steps + last_judged
            last, last_judged = count, steps
        rest = judged - worst_judged
        shares[horizon] = (total - worst) / rest if rest > 0.0 else 1.0


@kernel(f"Tuple(({FLOATS}, {FLOATS}))({FLOATS}, {TABLE}, {FLOATS}, int64)")
def expect_by_delay(
    ages: Floats, in_phase: Floats, noticed: Floats, delays: int
) -> tuple[Floats, Floats]:
    """Return what is expected of each delay E from 0 on, in steps of 10 ms.

    Parameters
    ----------
    ages : ndarray
        Weight of each age of the newest sample, in steps of 10 ms from 0.
    in_phase, noticed : ndarray
        As in `ExpectedErrors`. Beyond the longest horizon nothing is predicted: an error there is
        the worst one, and noticed.
    delays
        Number of delays.

    Returns
    -------
    squares, shares : ndarray, shape (delays,)
        Mean squared error in phase, and share of the time in which an error is noticed.
    """
    squares, shares, total = np.zeros(delays), np.zeros(delays), ages.sum()
    worst = in_phase.max()
    for age in range(len(ages)):
        weight = ages[age] / total
        if not weight > 0.0:
            continue
        for delay in range(delays):
            horizon = BLENDED * max(age - delay, 0)
            nearer, column = int(horizon), min(delay, DELAYS - 1)
            near_square, near_share, far_square, far_share = worst, 1.0, worst, 1.0
            if nearer <= HORIZONS:
                near_square, near_share = in_phase[nearer, column], noticed[nearer]
            if nearer < HORIZONS:
                far_square, far_share = in_phase[nearer + 1, column], noticed[nearer + 1]
            beyond = horizon - nearer
            squares[delay] += weight * (near_square + beyond * (far_square - near_square))
            shares[delay] += weight * (near_share + beyond * (far_share - near_share))
    return squares, shares


class PathErrors:
    """Errors to expect of the paths of each channel, learnt from the last ones.

    steps: number of those that were judged.
    """

    def __init__(self, channels: int) -> None:
        self._paths = np.zeros((channels, KEPT, HORIZONS))
        self._values = np.zeros((channels, KEPT))
        self._in_phase = np.zeros((channels, HORIZONS + 1, DELAYS))
        self._noticed = np.zeros((channels, BLOCKS, HORIZONS + 2))
        self._disturbed = np.zeros((channels, HORIZONS + 1))
        self._sums = np.zeros((channels, ERRORS, HORIZONS + 1))
        self._heights, self._noticeable = np.zeros((2, channels))
        # What no predictor can know: white noise of the sensor.
        self._white, self._last = np.full(channels, FIRST_WHITE), np.zeros(channels)
        self.steps = 0

    def add(self, newest: Floats, paths: Floats, heights: Floats, artefact: bool = False) -> None:
        """Judge the last paths by the newest values, and store new ones. Call it every 10 ms.

        Parameters
        ----------
        newest : ndarray, shape (channels,)
            Newest value of each channel.
        paths : ndarray, shape (channels, 25)
            Predicted values 10, 20, … 250 ms later.
        heights : ndarray, shape (channels,)
            Height of the pulse from foot to peak.
        artefact
            Whether the values are those of an artefact, which is soon forgotten.
        """
        self._heights[:] = heights
        np.square(JND * heights, out=self._noticeable)
        memory = min(MEMORY_STEPS, FIRST_STEPS + self.steps / 5)
        add_errors(
            self._paths,
            self._in_phase,
            self._noticed,
            self._disturbed,
            self._sums,
            self._values,
            self.steps,
            newest,
            paths,
            self._noticeable,
            self._white,
            self._last,
            1.0 / memory,
            artefact,
        )
        self.steps += 1

    def expected(self, channel: int, scale: float, steps: int) -> ExpectedErrors | None:
        """Return the errors to expect of a channel; None before all horizons were judged.

        scale: force in N of a difference of 1. steps: number of the last ones that count as the
        last beat, below `ERRORS`.
        """
        if self.steps < HORIZONS + max(DELAYS, steps):
            return None
        squares, sums = scale * scale, self._sums[channel]
        newest, noticed = (self.steps - 1) // BLOCK_STEPS, np.empty(HORIZONS + 1)
        blocks = min(max(FEWEST_BLOCKS, (newest + 1) // 3), newest + 1, BLOCKS)
        average_noticed(self._noticed[channel], newest, blocks, noticed)
        lately = sums[self.steps % ERRORS] - sums[(self.steps - steps) % ERRORS]
        return ExpectedErrors(
            squares / steps * np.maximum(lately[1:], 0.0),
            squares * np.maximum(self._in_phase[channel] - self._white[channel], 0.0),
            np.maximum(noticed, self._disturbed[channel]),
            scale * self._heights.item(channel),
        )
