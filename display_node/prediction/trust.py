"""Choice of the perceived delay E from the errors that the predictor expects. Pure.

`Trust` chooses the perceived delay E for `compensation = "auto"`. With the age of the newest sample
at each tick and the error that the predictor expects at each horizon, it computes the expected
error for every E. The chosen E is the smallest at which a finger does not notice this error.
"""

import math
import statistics
from collections import deque
from collections.abc import Sequence
from operator import mul

# A window contains a whole beat down to 30 beats a minute; an artefact affects one or two windows.
WINDOW_NS = 2_000_000_000
WINDOWS = 5


class PulseSize:
    """The pulse's height from foot to peak: the median over the last windows of 2 s.

    size: height in N; None before the first window has ended.
    """

    def __init__(self) -> None:
        self._sizes: deque[float] = deque(maxlen=WINDOWS)
        self._begun_ns: int | None = None
        self._low = self._high = 0.0
        self.size: float | None = None

    def observe(self, t_ns: int, values: list[float]) -> None:
        """Take a frame's samples in N, the first taken at t_ns."""
        low, high = min(values), max(values)
        if self._begun_ns is not None:
            if t_ns - self._begun_ns < WINDOW_NS:
                if low < self._low:
                    self._low = low
                if high > self._high:
                    self._high = high
                return
            self._sizes.append(self._high - self._low)
            self.size = statistics.median(self._sizes)
        self._begun_ns, self._low, self._high = t_ns, low, high


# Distance of the delays that are compared, and of the horizons of the predictor's errors.
STEP_NS = 10_000_000
HORIZONS = 25
# Bounds of the RMSE as a share of the pulse's height. With them the pulse felt differs by about
# 1 % more from the pulse E earlier than without prediction. A finger notices differences above 7 to
# 10 %, and peak errors are 2.5 times the RMSE.
RISE_ABOVE, FALL_BELOW = 0.018, 0.012
# RMSE of longer horizons, as a share of the height.
WORST = 0.3
# E falls to what was possible during all of the last second: the error changes within a beat.
CALM_STEPS = 100
AGES_MEMORY_S = 1.5
KEPT = math.exp(-STEP_NS * 1e-9 / AGES_MEMORY_S)
# Greatest reduction of E by trust: above 0.5 s the playout would jump instead of slewing.
MOST_NS = 400_000_000
# Ages beyond the longest horizon at the greatest reduction count alike.
AGES = HORIZONS + MOST_NS // STEP_NS + 2


class Trust:
    """Choice of the smallest perceived delay E at which prediction errors go unnoticed.

    E rises at once when its expected error exceeds 1.8 % of the pulse's height. It falls when a
    smaller E had less than 1.2 % during all of the last second.

    given: whether prediction replaces a part of the delay that the link requires.
    """

    def __init__(self) -> None:
        # Time in ns that the newest sample spent at each age, by steps; older times count less.
        self._ages = [0.0] * AGES
        self._last_ns: int | None = None
        self._next_ns = 0
        self._rise_to = self._fall_to = 0
        # Sliding maximum: numbers of evaluations rise and delays fall, so the first is the largest.
        self._calm = deque([(0, AGES)])
        self._evaluations = 0
        self._steps = AGES
        self.given = False

    def observe(self, now_ns: int, age_ns: int) -> bool:
        """Count the age of the newest sample at a tick; return whether to call `evaluate` now."""
        if self._last_ns is not None:
            steps = -(-age_ns // STEP_NS)
            self._ages[min(max(steps, 0), AGES - 1)] += now_ns - self._last_ns
        self._last_ns = now_ns
        return now_ns >= self._next_ns

    def evaluate(self, now_ns: int, required_ns: int, error_shares: Sequence[float]) -> None:
        """Choose E anew.

        Parameters
        ----------
        required_ns
            Delay in ns that the link requires without prediction.
        error_shares
            Expected squares of the error over the square of the pulse's height, at 10, 20, …
            250 ms after the newest sample; empty where unknown.
        """
        self._next_ns = now_ns + STEP_NS
        # At least one step: the few milliseconds of a local network are predicted as well.
        most = max(required_ns // STEP_NS, 1)
        if not error_shares:
            self._rise_to = self._fall_to = most
        else:
            worst = WORST**2
            squares = [worst if share > worst else share for share in error_shares]
            self._rise_to = self._least(self._rise_to, most, squares, RISE_ABOVE)
            self._fall_to = self._least(self._fall_to, most, squares, FALL_BELOW)
        self._ages = [age * KEPT for age in self._ages]
        calm_to = self._longest_of_last_second()
        self._steps = min(max(self._steps, self._rise_to), calm_to, most)
        self.given = self._steps < most

    def delay_ns(self, required_ns: int) -> int:
        """Return E in ns for the delay in ns that the link requires without prediction."""
        if not self.given:
            return required_ns
        return max(min(self._steps * STEP_NS, required_ns), required_ns - MOST_NS)

    def _least(self, near: int, most: int, squares: list[float], bound: float) -> int:
        """Return the fewest steps of E, up to `most`, with an RMSE of at most `bound`.

        The search begins near the last result, because it changes slowly.
        """
        limit = bound * bound * sum(self._ages)
        steps = min(near, most)
        while steps < most and self._error(steps, squares) > limit:
            steps += 1
        while steps > 0 and self._error(steps - 1, squares) <= limit:
            steps -= 1
        return steps

    def _error(self, steps: int, squares: list[float]) -> float:
        """Return the time integral of the squared error in ns at an E of some steps."""
        later = self._ages[steps + 1 :]
        predicted: float = sum(map(mul, later, squares))
        return predicted + WORST**2 * sum(later[HORIZONS:])

    def _longest_of_last_second(self) -> int:
        calm = self._calm
        self._evaluations += 1
        while calm and calm[-1][1] <= self._fall_to:
            calm.pop()
        calm.append((self._evaluations, self._fall_to))
        if calm[0][0] <= self._evaluations - CALM_STEPS:
            calm.popleft()
        return calm[0][1]
