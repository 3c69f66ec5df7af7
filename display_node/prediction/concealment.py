"""Concealment: the force where no sample has arrived, without jumps.

Pure: samples and times are arguments.
"""

import math
from typing import TYPE_CHECKING

from display_node.prediction import DECAY_OVER_HORIZON, Predictor
from display_node.prediction.trust import PulseSize
from protocol.wire.messages import ChannelSamples

if TYPE_CHECKING:
    from display_node.prediction.path_errors import ExpectedErrors

NEGLIGIBLE_N = 1e-6


class Blend:
    """Continuous transition from each tick's path of predicted force to the next tick's.

    A new frame corrects the prediction, so the force at the present time jumps. The jump is
    removed by an offset that decays. offset_n: its present value. busy: whether the last path was
    predicted, or an offset is still in effect.
    """

    def __init__(self, tick_ns: int) -> None:
        self._tick_ns = tick_ns
        self._path_n: list[float] = []
        self._sampled_ns = self._newest_ns = 0
        # Horizon of the prediction that caused the offset. It at most halves with each frame, so
        # that a short horizon after a long one does not drop a large offset at once.
        self._spanned_ns = 0
        self._kept = self.offset_n = 0.0
        self.busy = False

    def apply(self, path_n: list[float], sampled_ns: int, newest_ns: int) -> list[float]:
        """Return the path without the jump from the last one.

        Parameters
        ----------
        path_n
            Force in N at `sampled_ns` and at the ticks after it. While not `busy`, at least the
            last value is a prediction.
        newest_ns
            Time of the newest sample in ns.
        """
        if newest_ns != self._newest_ns:
            self._spanned_ns = max(self._sampled_ns - self._newest_ns, self._spanned_ns // 2)
            decay_ticks = DECAY_OVER_HORIZON * self._spanned_ns / self._tick_ns
            self._kept = math.exp(-1 / decay_ticks) if decay_ticks > 0 else 0.0
            self._newest_ns = newest_ns
        self.offset_n = offset_n = self._offset_at(path_n[0], sampled_ns)
        self._sampled_ns, kept = sampled_ns, self._kept
        last_ns = sampled_ns + (len(path_n) - 1) * self._tick_ns
        if last_ns <= newest_ns and abs(offset_n) < NEGLIGIBLE_N:
            self.offset_n, self._path_n, self.busy = 0.0, [], False
            return path_n
        self._path_n, self.busy = path_n, True
        joined_n = []
        for force_n in path_n:
            joined_n.append(force_n + offset_n)
            offset_n *= kept
        return joined_n

    def _offset_at(self, force_n: float, sampled_ns: int) -> float:
        """Return the rest of the decaying offset plus the jump from the last path to this force."""
        path_n = self._path_n
        ticks, count = (sampled_ns - self._sampled_ns) / self._tick_ns, len(path_n)
        # After missed ticks or a jump of the playout, the paths do not overlap.
        if not 0 < ticks < count:
            return 0.0
        before = int(ticks)
        if before > count - 2:
            before = count - 2
        start_n = path_n[before]
        expected_n = start_n + (ticks - before) * (path_n[before + 1] - start_n)
        offset_n = self.offset_n * self._kept**ticks + expected_n - force_n
        return offset_n if math.isfinite(offset_n) else 0.0


class Concealment:
    """Prediction of one channel where no sample has arrived, blended with the received force.

    Forces are those at the wrist, in N. Times are on the sensing clock. predictor: of the channel.
    acts: whether the force is predicted, or is still blended into the received one. offset_n: the
    part of the last force that the blend removes. height_n: the pulse's height from foot to peak;
    None while unknown.
    """

    def __init__(self, predictor: Predictor, tick_ns: int) -> None:
        self._tick_ns = tick_ns
        self._predictor = predictor
        self._blend = Blend(tick_ns)
        self._size = PulseSize()
        # Attributes, and no properties: these are read each tick.
        self.acts, self.offset_n = False, 0.0
        self.height_n: float | None = None
        self.work = self._predictor.work
        self.error_n = self._predictor.error_n

    @property
    def expected(self) -> "ExpectedErrors | None":
        """Errors to expect of the prediction, as of `Predictor`."""
        return self._predictor.expected

    def observe(self, samples: ChannelSamples) -> None:
        """Take the samples of a frame, late or not."""
        self._predictor.observe(samples.times_ns, samples.forces_n)
        self._size.observe(samples.times_ns[0], samples.forces_n)
        expected = self._predictor.expected
        self.height_n = self._size.size if expected is None else expected.height_n

    def complete(
        self, path_n: list[float], count: int, sampled_ns: int, newest_ns: int
    ) -> list[float]:
        """Return the force at `count` times, one a tick from sampled_ns on, without a jump.

        Call it while the prediction `acts`, and where a value is missing.

        Parameters
        ----------
        path_n
            Received force in N at the first of these times; it is completed in place.
        newest_ns
            Time of the newest sample.
        """
        predict, tick_ns, blend = self._predictor.predict, self._tick_ns, self._blend
        for step in range(len(path_n), count):
            path_n.append(predict(sampled_ns + step * tick_ns))
        path_n = blend.apply(path_n, sampled_ns, newest_ns)
        self.acts, self.offset_n = blend.busy, blend.offset_n
        return path_n
