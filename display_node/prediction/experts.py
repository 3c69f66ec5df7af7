"""The experts of the stack: beat analogues with a local regression, and a long linear filter.

Each expert predicts the history's values at `HORIZONS` common horizons up to 250 ms ahead: of its
first channel, and from the same past of that channel those of the others, which are the same pulse
at other places. The package's docstring lists the places to change when you add a predictor.
"""

from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dger, dsymv, dsyr
from scipy.linalg.lapack import sposv, spotrs

from display_node.prediction.grid import STEP_NS, History

# The horizons are 10 ms apart, up to 250 ms, and a cubic joins them: the pulse ends below 40 Hz.
# Experts predict at every step of 5 ms, and learn from every second one.
SPACING, HORIZONS = 2, 25
AHEAD = SPACING * np.arange(1, HORIZONS + 1)
FURTHEST = SPACING * HORIZONS
Floats = NDArray[np.float64]
Row = NDArray[np.float32]
Places = NDArray[np.intp]


class Expert(Protocol):
    """Predictor of a history's values `AHEAD` steps after the newest, as one or more trajectories.

    names: of its trajectories. trust: weight of each of them at the stack's start.
    """

    names: tuple[str, ...]
    trust: tuple[float, ...]

    def predict(self, history: History, made: Floats) -> None:
        """Write the predicted differences from the newest value into `made`, shape (names, 25).

        Zeros, which hold the newest value, mean that the expert has not learnt enough.
        """

    def predict_others(self, history: History, made: Floats) -> None:
        """Write the trajectories of the other channels into `made`, shape (others, names, 25).

        Call it after `predict`.
        """

    def learn(self, history: History, artefact: bool = False) -> None:
        """Learn from the newest value; call it after `predict` at every second step.

        artefact: whether one is present; nothing that outlasts it is then learnt.
        """

    def prepare(self, history: History) -> Iterator[None]:
        """Prepare the next predictions, in pieces; call it after `predict` at the steps between."""
        return iter(())


LAGS = 8_000
# Smallest lag. At smaller ones, the next 250 ms are not known yet, or the beat is the present one.
NEAREST = 60
MEMORIES_S = (0.05, 0.2, 0.6)
NAMES = (*[f"analogue {memory_s:g} s" for memory_s in MEMORIES_S], "analogue regression")
FORGETS = np.exp(-SPACING * STEP_NS * 1e-9 / np.array(MEMORIES_S, np.float32))[:, np.newaxis]
# Weight of the slope (per SPACING steps): the ratio of a pulse's power to that of its slope, so
# that both count about equally. In the shortest memory it is more, which finds the beginning of a
# beat sooner; in the others, more is noise.
SLOPE, FIRST_SLOPE = 12.5, 150.0
# Analogues of each memory. Of the first memory's, a mean uses the nearest AVERAGED, the regression
# all.
COUNTS, AVERAGED = (40, 15, 15), 15
# The memory of each analogue; what it keeps of a distance and the factors of the squares of
# difference and slope.
MEMORY = np.repeat(np.arange(len(COUNTS)), COUNTS)
KEPT = FORGETS[MEMORY, 0]
SCALES = np.array([[1.0, SLOPE if memory else FIRST_SLOPE] for memory in MEMORY], np.float32)
# First analogue of each memory, and of each part of them that a trajectory uses.
_SECOND, _THIRD = COUNTS[0], COUNTS[0] + COUNTS[1]
MEMORIES, PARTS = np.array([0, _SECOND, _THIRD]), np.array([0, AVERAGED, _SECOND, _THIRD])
# Kernels' widths over the sums of the distances in each part, by part and trajectory: 0.2 of the
# mean distance for a mean, all of the nearest ones' for the regression.
WIDTHS = np.zeros((4, 4), np.float32)
WIDTHS[[0, 2, 3, 0], [0, 1, 2, 3]] = np.array([0.2, 0.2, 0.2, 1.0]) / AVERAGED
# Minus infinity where a trajectory does not use an analogue.
UNUSED = np.full((4, len(MEMORY)), -np.inf, np.float32)
UNUSED[0, :AVERAGED] = UNUSED[1, _SECOND:_THIRD] = UNUSED[2, _THIRD:] = 0.0
UNUSED[3, :_SECOND] = 0.0
# Share of the analogue's difference from the present value that its continuation is reduced by.
OFFSET = 0.35
# A lag is used after its distance has been summed over this number of steps. The longer memories
# then still contain zeros from before the start, which make old lags less similar, not more.
SETTLED = 20
# Lags of the regression's inputs. From an analogue, steps to its value, inputs and outputs.
LOCAL = np.array([2, 1, 3, 4, 6, 8, 11, 14, 18, 24, 32, 40, 50, 60, 80, 100, 130, 160, 200])
PASSAGE = np.concatenate([[0], -LOCAL, AHEAD])
BEFORE, AFTER = slice(1, len(LOCAL) + 1), slice(len(LOCAL) + 1, None)
PRESENT, DEEPEST = LAGS - LOCAL, int(LOCAL[-1])
# The same of another channel: steps to its value, and outputs.
CONTINUATION = np.concatenate([[0], AHEAD])
# The weights of the analogues add up to 1.
LOCAL_RIDGE = 0.00003 * np.eye(len(LOCAL), dtype=np.float32)


class Analogue(Expert):
    """Continuation of the moments of the last 40 s that are most similar to the present.

    The present's distance from each lag l, with a memory λ, is updated by

        D(l) ← λ D(l) + (x(t) − x(t−l))² + w (ẋ(t) − ẋ(t−l))²,

    and its lowest local minima are the analogues. The first trajectories are the analogues' mean
    continuations, one for each memory. The last is a ridge regression of the continuations on past
    values, among the analogues of the shortest memory: a linear filter for this moment of the beat.

    The lags of the minima and the regression's gains change slowly. They are computed for the next
    steps, which update the analogues' distances and means: so no prediction waits for them.

    References
    ----------
    Lorenz (1969), analogues as predictors; Sugihara (1994), locally weighted linear maps.
    """

    trust: tuple[float, ...] = (0.6, 0.2, 0.0, 0.0)

    def __init__(self) -> None:
        self.names: tuple[str, ...] = NAMES
        # Oldest first, like the history: index i is the lag LAGS − i. Single precision saves time
        # in these long rows; their noise exceeds its rounding.
        self._difference, self._slope, self._square = np.zeros((3, LAGS), np.float32)
        self._distances = np.zeros((len(MEMORIES_S), LAGS), np.float32)
        self._found = self._regresses = False
        # The regression's gains of the other channels, side by side.
        self._other_gains = np.zeros((len(LOCAL), 0), np.float32)

    def predict(self, history: History, made: Floats) -> None:
        """Write the analogues' mean continuations, and their regression."""
        if not self._found:
            made[:] = 0.0
            return
        past = history.last(LAGS + 1)
        newest, around = past[-1], past.take(self._around)
        apart = around[:, :2] - past[-1 : -2 - SPACING : -SPACING]
        apart[:, 1] -= apart[:, 0]
        apart *= apart
        self._weights = _kernels(self._nearest + np.einsum("ij,ij->i", apart, SCALES))
        mean = self._weights @ around
        origins = mean[:, :1].copy()
        mean -= origins
        made[:] = mean[:, AFTER]
        made[:-1] += (1 - OFFSET) * (origins[:-1] - newest)
        if not self._regresses:
            made[-1] = made[0]
            return
        made = made[-1]
        self._inputs = past.take(PRESENT) - newest - mean[-1, BEFORE]
        made += self._inputs @ self._gains
        # A present unlike all its analogues is not extrapolated beyond them.
        np.maximum(made, self._low, out=made)
        np.minimum(made, self._high, out=made)

    def predict_others(self, history: History, made: Floats) -> None:
        """Write the continuations of the other channels after the first one's analogues."""
        if not self._found:
            made[:] = 0.0
            return
        past = history.rows(LAGS + 1)[1:]
        mean = self._weights @ past.take(self._beside, axis=1)
        origins = mean[..., :1].copy()
        mean -= origins
        made[:] = mean[..., 1:]
        made[:, :-1] += (1 - OFFSET) * (origins[:, :-1] - past[:, np.newaxis, -1:])
        if not self._regresses:
            made[:, -1] = made[:, 0]
            return
        last = made[:, -1]
        last += (self._inputs @ self._other_gains).reshape(last.shape)
        np.maximum(last, self._other_low, out=last)
        np.minimum(last, self._other_high, out=last)

    def prepare(self, history: History) -> Iterator[None]:
        """Update all distances, and find the analogues of the next two steps."""
        self._observe(history.last(LAGS + 1))
        yield
        first = LAGS - min(LAGS - DEEPEST, history.count - SETTLED)
        self._found = first < LAGS - NEAREST - 2 and self._search(first)
        if self._found and history.channels > 1:
            self._beside = self._around[:, :1] + CONTINUATION

    def _observe(self, past: Row) -> None:
        # The slopes' difference is the change of the values' difference since the last time.
        difference, slope, square = self._slope, self._difference, self._square
        np.subtract(past[:-1], past[-1], out=difference)
        slope -= difference
        self._difference, self._slope = difference, slope
        np.multiply(difference, difference, out=square)
        slope *= slope
        slope *= SLOPE
        square += slope
        self._distances *= FORGETS
        self._distances += square
        slope *= FIRST_SLOPE / SLOPE - 1
        self._distances[0] += slope

    def _search(self, first: int) -> bool:
        """Find each memory's lowest local minima from `first` on; return whether all have some."""
        distances = self._distances[:, first : LAGS - NEAREST + 1]
        rises = distances[:, 1:] >= distances[:, :-1]
        is_lowest = rises[:, 1:] > rises[:, :-1]
        found = []
        for chosen, row, count in zip(is_lowest, distances[:, 1:], COUNTS, strict=True):
            (at,) = chosen.nonzero()
            if len(at) > count:
                at = at[row[at].argpartition((AVERAGED, count - 1))[:count]]
            elif not len(at):
                return False
            found.append(at if len(at) == count else np.resize(at, count))
        places = np.concatenate(found)
        places += first + 1
        self._nearest = self._distances.take(places + LAGS * MEMORY)
        self._nearest *= KEPT
        self._around = places[:, np.newaxis] + PASSAGE
        return True

    def learn(self, history: History, artefact: bool = False) -> None:
        """Make the regression for the next two steps."""
        self._regresses = False
        if not self._found:
            return
        around = history.last(LAGS + 1).take(self._around[: COUNTS[0]] + 1)
        around -= around[:, :1]
        after = around[:, AFTER].copy()
        self._low, self._high = np.minimum.reduce(after), np.maximum.reduce(after)
        weights = self._weights[-1, : COUNTS[0]]
        around -= weights @ around
        before = around[:, BEFORE]
        weighted = before.T * weights
        products = weighted @ after
        if history.channels > 1:
            products = np.concatenate([products, weighted @ self._after_others(history)], axis=1)
        gains, failed = solve(weighted @ before + LOCAL_RIDGE, products)
        self._gains, self._other_gains = gains[:, :HORIZONS], gains[:, HORIZONS:]
        # Rounding exceeds the ridge where the pulse has become a thousand times as large.
        self._regresses = not failed

    def _after_others(self, history: History) -> Row:
        """Return the continuations of the other channels after each analogue, side by side."""
        # One step later, each place is one step nearer to the present.
        around = history.rows(LAGS)[1:].take(self._beside[: COUNTS[0]], axis=1)
        after = around[..., 1:] - around[..., :1]
        self._other_low = np.minimum.reduce(after, axis=1)
        self._other_high = np.maximum.reduce(after, axis=1)
        beside: Row = after.transpose(1, 0, 2).reshape(COUNTS[0], -1)
        return beside


def solve(squares: Row, products: Row) -> tuple[Row, bool]:
    """Solve a positive definite system for each column of `products`; return whether it failed.

    The columns of each channel are solved on their own: LAPACK uses threads for more, which wait
    for a processor on a host that is busy. Three channels at once took 50 ms there.
    """
    factor, solved, failed = sposv(squares, products[:, :HORIZONS])
    if products.shape[1] > HORIZONS:
        parts = [solved]
        for begin in range(HORIZONS, products.shape[1], HORIZONS):
            parts.append(spotrs(factor, products[:, begin : begin + HORIZONS])[0])
        solved = np.concatenate(parts, axis=1)
    return solved, bool(failed)


def _kernels(distances: Row) -> Row:
    """Return each trajectory's weights of the analogues, which fall with the distance; sums 1."""
    # The small constant keeps the width above 0 where all distances are 0.
    widths = np.add.reduceat(distances, PARTS) @ WIDTHS + 1e-30
    distances = distances - np.minimum.reduceat(distances, MEMORIES).take(MEMORY)
    weights = np.exp(UNUSED - distances / widths[:, np.newaxis])
    weights /= np.add.reduce(weights, axis=1, keepdims=True)
    return weights


# Taps of the filter: the near past at every step, and further back, to 1.3 s, means over STRIDE.
NEAR, FAR, STRIDE = 40, 55, 4
REACH = NEAR + FAR * STRIDE + 1
TAPS = NEAR + FAR
MEAN = np.full(STRIDE, 1 / STRIDE, np.float32)
# Forgetting factor for a memory of 30 s.
FORGET = 1 - SPACING / 6_000
# Relative to the power of the signal, as it is normalised.
RIDGE = 0.005
# The forgotten part of the ridge is restored after this number of regressors.
RESTORED = 4
# The covariance's factor is applied when it exceeds this.
LARGEST_FACTOR = 1e3


class Fir(Expert):
    """x(t+h) − x(t) as a linear function of x(t−i) − x(t), for every horizon h.

    Recursive least squares gives the ridge solution of all data at every step without solving a
    system. A regressor is used when the values at all its horizons have come, 250 ms later: then
    its gain is the same for every horizon, and values that late samples corrected are correct.

    References
    ----------
    Haykin, Adaptive Filter Theory, exponentially weighted RLS.
    """

    names: tuple[str, ...] = ("fir",)
    trust: tuple[float, ...] = (0.2,)

    def __init__(self) -> None:
        # In the memory order of BLAS, which updates in place.
        self._weights = np.zeros((TAPS, HORIZONS), order="F")
        # Of each other channel. BLAS computes a larger matrix in threads, which wait for a
        # processor on a host that is busy.
        self._other_weights: list[Floats] = []
        # One triangle of the covariance over a factor, so that forgetting is no pass over it.
        self._covariance = np.asfortranarray(np.eye(TAPS) / RIDGE)
        self._factor = 1.0
        # Regressors of the last 250 ms.
        self._regressors = np.zeros((HORIZONS, TAPS))
        self._regressor = np.zeros(TAPS)
        self._count = 0

    def predict(self, history: History, made: Floats) -> None:
        """Write the trajectory of the newest regressor."""
        if history.count < REACH:
            made[:] = 0.0
            return
        past, regressor = history.last(REACH), self._regressor
        regressor[:FAR] = past[: FAR * STRIDE].reshape(FAR, STRIDE) @ MEAN
        regressor[FAR:] = past[FAR * STRIDE : -1]
        regressor -= past[-1]
        np.matmul(regressor, self._weights, out=made[0])

    def predict_others(self, history: History, made: Floats) -> None:
        """Write the trajectories of the other channels."""
        if history.count < REACH or not self._other_weights:
            made[:] = 0.0
            return
        for trajectories, weights in zip(made, self._other_weights, strict=True):
            np.matmul(self._regressor, weights, out=trajectories[0])

    def learn(self, history: History, artefact: bool = False) -> None:
        """Correct the weights by the regressor of 250 ms ago, and store the newest one."""
        if history.count < REACH:
            return
        regressor = self._regressors[self._count % HORIZONS]
        self._count += 1
        if self._count > HORIZONS and not artefact:
            values = history.last(FURTHEST + 1)[::SPACING]
            errors = values[1:] - values[0] - regressor @ self._weights
            # BLAS works on one triangle, so the covariance stays symmetric.
            spread = dsymv(self._factor, self._covariance, regressor)
            power = FORGET + float(regressor @ spread)
            if history.channels > 1:
                self._correct_others(history, regressor, spread / power)
            self._correct(spread, power, errors)
            self._factor /= FORGET
            if self._count % RESTORED == 0:
                self._keep_ridge()
        regressor[:] = self._regressor

    def _keep_ridge(self) -> None:
        """Observe one weight as 0, which restores the forgotten part of the ridge."""
        if self._factor > LARGEST_FACTOR:
            self._covariance *= self._factor
            self._factor = 1.0
        tap = self._count // RESTORED % TAPS
        covariance = self._covariance
        spread = self._factor * np.concatenate([covariance[:tap, tap], covariance[tap, tap:]])
        power = 1 / (RIDGE * TAPS * RESTORED * (1 - FORGET)) + spread[tap]
        for others in self._other_weights:
            dger(-1.0 / power, spread, others[tap].copy(), a=others, overwrite_a=1)
        self._correct(spread, power, -self._weights[tap])

    def _correct_others(self, history: History, regressor: Floats, gain: Floats) -> None:
        rows = history.rows(FURTHEST + 1)[1:, ::SPACING]
        if not self._other_weights:
            self._other_weights = [np.zeros((TAPS, HORIZONS), order="F") for _ in rows]
        for row, weights in zip(rows, self._other_weights, strict=True):
            errors = row[1:] - row[0] - regressor @ weights
            dger(1.0, gain, errors, a=weights, overwrite_a=1)

    def _correct(self, spread: Floats, power: float, errors: Floats) -> None:
        dger(1.0 / power, spread, errors, a=self._weights, overwrite_a=1)
        dsyr(-1.0 / (power * self._factor), spread, a=self._covariance, overwrite_a=1)
