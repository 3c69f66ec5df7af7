"""Choice of the perceived delay E from the errors that the predictor expects. Pure.

`Trust` combines the age of the newest sample at each tick with the errors that the predictor
expects at each horizon (`path_errors.py`) to those of every E, and chooses:

- `compensation = "auto"`: the E of the least error in phase, among those at which a finger notices
  an error of the prediction for at most a share of the time. Where there is none, the E at which it
  notices one for the least time.
- `compensation = "shape"`: the least E at which the prediction changes no shape of the pulse.
"""

import statistics
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np

from display_node.prediction.grid import STEP_NS as CELL_NS

if TYPE_CHECKING:
    from display_node.prediction.path_errors import ExpectedErrors

Floats = np.ndarray[tuple[int, ...], np.dtype[np.float64]]

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
# E is chosen anew after this time; the playout follows it by 2.5 ms in it.
CHOSEN_EVERY_NS = 50_000_000
# Ages are counted by blocks of half a second: those of the last 1.5 s, or of 5 s without the worst.
BLOCK_NS = 500_000_000
BLOCKS, LATELY_BLOCKS = 10, 3
# Expected shares of the time are corrected until those felt are the target: by so much a choice for
# each time the target that they are off, at most half of it, within bounds.
FOLLOWS = CHOSEN_EVERY_NS / 15e9
MOST_EXCESS, LEAST_CORRECTION, MOST_CORRECTION = 0.5, 0.5, 2.5
# Excess of the mean age in a second with a stall, in steps.
STALLED = 2.0
# Square of the least height of a pulse, in N².
LEAST_N2 = 1e-12
# Greatest reduction of E by trust: above 0.5 s the playout would jump instead of slewing.
MOST_NS = 400_000_000
# Ages beyond the longest horizon at the greatest reduction count alike.
AGES = HORIZONS + MOST_NS // STEP_NS + 2
OLDEST = AGES - 1.001
DelayChoice = Literal["auto", "shape"]
"""How `compensation` chooses E."""


class SampleAges:
    """Times for which the newest sample had each age, in steps of 10 ms, shape (AGES,).

    last_ns: time of the last tick; None before the first.
    """

    def __init__(self) -> None:
        # By block, of which the present one is a list: it is faster in each tick.
        self._blocks = np.zeros((BLOCKS, AGES))
        self._block = [0.0] * AGES
        self._steps = np.arange(AGES, dtype=float)
        self._number = -1
        self.last_ns: int | None = None

    def add(self, now_ns: int, age_ns: int) -> None:
        """Count the age of the newest sample at a tick."""
        if self.last_ns is not None:
            number = now_ns // BLOCK_NS
            if number != self._number:
                self._begin(number)
            elapsed_ns, block = now_ns - self.last_ns, self._block
            # A path counts from the middle of the newest cell.
            steps = (age_ns + CELL_NS // 2) / STEP_NS
            if steps < 0.0:
                steps = 0.0
            elif steps > OLDEST:
                steps = OLDEST
            whole = int(steps)
            beyond = (steps - whole) * elapsed_ns
            block[whole] += elapsed_ns - beyond
            block[whole + 1] += beyond
        self.last_ns = now_ns

    def _begin(self, number: int) -> None:
        """Begin a block; a pause has skipped some."""
        self._blocks[self._number % BLOCKS] = self._block
        skipped = np.arange(max(self._number + 1, number - BLOCKS + 1), number + 1)
        self._blocks[skipped % BLOCKS] = 0.0
        self._number, self._block = number, [0.0] * AGES

    def _counted(self) -> Floats:
        """Return all blocks, in the order of time."""
        self._blocks[self._number % BLOCKS] = self._block
        return np.roll(self._blocks, -(self._number + 1) % BLOCKS, axis=0)

    @property
    def lately(self) -> Floats:
        """Ages of the last 1.5 s."""
        ages: Floats = self._counted()[-LATELY_BLOCKS:].sum(axis=0)
        return ages

    @property
    def usual(self) -> Floats:
        """Ages of the last 5 s, without the two adjacent blocks of a single stall.

        A stall is not what E is chosen for: no E that the link permits would cover it.
        """
        blocks = self._counted()
        total: Floats = blocks.sum(axis=0)
        pairs = blocks[1:] + blocks[:-1]
        worst = pairs[(pairs @ self._steps).argmax()]
        usual: Floats = total - worst
        if not usual.any() or self._mean(worst) < self._mean(usual) + STALLED:
            return total
        return usual

    def _mean(self, ages: Floats) -> float:
        return float(ages @ self._steps) / max(float(ages.sum()), 1.0)


class LeastError:
    """Choice of the E of the least error in phase, for `compensation = "auto"`.

    noticed_target: greatest share of the time in which a finger may notice an error of the
    prediction.
    """

    def __init__(self, noticed_target: float) -> None:
        # Imported here, since its kernels need numba, as every predictor that is trusted.
        from display_node.prediction.path_errors import expect_by_delay

        self._noticed_target, self._expect = noticed_target, expect_by_delay
        # Factor of the expected shares, and whether the target permits no smaller E.
        self._correction, self._limited = 1.0, False

    def steps(self, ages: SampleAges, most: int, expected: "Sequence[ExpectedErrors]") -> float:
        """Return the steps of E, up to `most`; expected: errors of each contactor."""
        usual = ages.usual
        in_phase, noticed = np.zeros((2, min(most, AGES - 1) + 1))
        for each in expected:
            squares, shares = self._expect(usual, each.in_phase_n2, each.noticed, len(in_phase))
            in_phase += squares / max(each.height_n**2, LEAST_N2)
            np.maximum(noticed, shares, out=noticed)
        # After a stall it is noticed at every E: then what is added by a smaller one counts.
        noticed = (noticed - noticed[-1]) * self._correction
        allowed = noticed <= self._noticed_target
        chosen = int(np.where(allowed, in_phase, np.inf).argmin())
        self._limited = chosen > 0 and not allowed[chosen - 1]
        if not self._limited:
            return chosen
        # Between two steps, where the target is reached.
        more, less = noticed[chosen - 1], noticed[chosen]
        return float(chosen - (self._noticed_target - less) / (more - less))

    def follow(self, noticed: float) -> None:
        """Take the share of the last 5 s in which an error of the prediction was felt.

        The correction is that of adaptive conformal inference (Gibbs and Candès, 2021), which
        leads the share that is felt to the target even where the expected one is wrong.
        """
        excess = min(noticed / self._noticed_target - 1.0, MOST_EXCESS)
        if excess > 0.0 or self._limited:
            corrected = self._correction * (1.0 + FOLLOWS * excess)
            self._correction = min(max(corrected, LEAST_CORRECTION), MOST_CORRECTION)


# Bounds of the RMSE as a share of the pulse's height, for "shape". With them the pulse felt differs
# by about 1 % more from the pulse E earlier than without prediction.
RISE_ABOVE, FALL_BELOW = 0.018, 0.012
# RMSE of longer horizons, as a share of the height.
WORST = 0.3
# E falls to what was possible during all of the last second: the error changes within a beat.
CALM_STEPS = 20


class KeptShape:
    """Choice of the least E at which no shape of the pulse is lost, for `compensation = "shape"`.

    E rises at once when its expected RMSE exceeds 1.8 % of the pulse's height. It falls when a
    smaller E had less than 1.2 % during all of the last second.
    """

    def __init__(self) -> None:
        # Sliding maximum: numbers of evaluations rise and delays fall, so the first is the largest.
        self._calm = deque([(0, AGES)])
        self._evaluations = 0
        self._steps = AGES
        horizon = np.arange(AGES)[:, np.newaxis] - np.arange(AGES)
        self._horizons = np.clip(horizon, 0, HORIZONS + 1)

    def steps(self, ages: SampleAges, most: int, expected: "Sequence[ExpectedErrors]") -> int:
        """Return the steps of E, as `LeastError` does."""
        lately = ages.lately
        if not lately.any():
            return most
        most = min(most, AGES - 1)
        square = np.zeros(HORIZONS + 2)
        square[-1] = WORST**2
        for each in expected:
            shares = each.squares_n2 / max(each.height_n**2, LEAST_N2)
            np.maximum(square[1:-1], np.minimum(shares, WORST**2), out=square[1:-1])
        errors = lately @ square[self._horizons[:, : most + 1]] / lately.sum()
        rise_to, fall_to = (
            int(np.argmax(errors <= bound**2)) for bound in (RISE_ABOVE, FALL_BELOW)
        )
        self._steps = min(max(self._steps, rise_to), self._longest_of_last_second(fall_to))
        return min(self._steps, most)

    def _longest_of_last_second(self, fall_to: int) -> int:
        calm = self._calm
        self._evaluations += 1
        while calm and calm[-1][1] <= fall_to:
            calm.pop()
        calm.append((self._evaluations, fall_to))
        if calm[0][0] <= self._evaluations - CALM_STEPS:
            calm.popleft()
        return calm[0][1]


class Trust:
    """Reduction of the delay that the link requires, by a predictor that is trusted.

    given: whether prediction replaces a part of that delay.
    """

    def __init__(self, choice: DelayChoice = "auto", noticed_target: float = 0.02) -> None:
        self._choice = LeastError(noticed_target) if choice == "auto" else KeptShape()
        self._ages = SampleAges()
        self._next_ns = self._required_ns = 0
        self._steps: float = AGES
        self.given = False

    def observe(self, now_ns: int, age_ns: int, required_ns: int) -> int:
        """Count the age of the newest sample at a tick, and return E in ns.

        required_ns: delay that the link requires without prediction.
        """
        self._ages.add(now_ns, age_ns)
        self._required_ns = required_ns
        if not self.given:
            return required_ns
        return max(min(round(self._steps * STEP_NS), required_ns), required_ns - MOST_NS)

    @property
    def due(self) -> bool:
        """True from the time on at which `choose` is to be called again."""
        last_ns = self._ages.last_ns
        return last_ns is not None and last_ns >= self._next_ns

    def choose(
        self, expected: "Sequence[ExpectedErrors | None]", noticed: float | None = None
    ) -> None:
        """Choose E anew, after the last tick's command.

        expected: errors to expect of the prediction of each contactor; None where unknown. noticed:
        share of the last 5 s in which an error of it was felt, the greatest of any contactor; None
        where it is unknown.
        """
        self._next_ns = (self._ages.last_ns or 0) + CHOSEN_EVERY_NS
        # At least one step: the few milliseconds of a local network are predicted as well.
        most = max(self._required_ns // STEP_NS, 1)
        known = [each for each in expected if each is not None]
        self._steps = most
        if len(known) == len(expected):
            if noticed is not None and isinstance(self._choice, LeastError):
                self._choice.follow(noticed)
            self._steps = self._choice.steps(self._ages, most, known)
        self.given = self._steps < most
