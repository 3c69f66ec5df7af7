"""The stand-in: what is felt where no sample has arrived, and whether to rely on it.

Smoothing: what newly arrives corrects the force that is felt without a jump.

A frame says more than was predicted: the prediction for the present instant jumps. The jump is
taken off again and given back by and by, as an offset that decays. Pure.
"""

import math

from display_node.prediction import UNLEARNT, PredictorName, build_predictor
from display_node.prediction.trust import PulseSize, Trust
from protocol.wire.messages import Frame

# The decay's time constant over the horizon that the old prediction had to span: the further it
# looked, the larger its corrections are, and the less a later one costs.
DECAY_OVER_HORIZON = 0.2
NEGLIGIBLE_N = 1e-6


class Blend:
    """Joins each tick's path of predicted force to the last one's.

    busy: the last path was predicted, or an offset is still felt.
    """

    def __init__(self, tick_ns: int) -> None:
        self._tick_ns = tick_ns
        self._path_n: list[float] = []
        self._instant_ns = self._newest_ns = 0
        # The horizon behind the offset; it falls by half a frame, so that a short one that
        # follows a long one does not let go of a large offset at once.
        self._spanned_ns = 0
        self._kept = 0.0
        self._offset_n = 0.0
        self.busy = False

    def apply(self, path_n: list[float], instant_ns: int, newest_ns: int) -> list[float]:
        """Return the path without the jump from the last one.

        path_n: force at instant_ns and a tick apart after it, of which some was predicted, or
        which comes while it is `busy`; newest_ns: the newest sample's time.
        """
        if newest_ns != self._newest_ns:
            self._spanned_ns = max(self._instant_ns - self._newest_ns, self._spanned_ns // 2)
            decay_ticks = DECAY_OVER_HORIZON * self._spanned_ns / self._tick_ns
            self._kept = math.exp(-1 / decay_ticks) if decay_ticks > 0 else 0.0
            self._newest_ns = newest_ns
        self._offset_n = offset_n = self._offset_at(path_n[0], instant_ns)
        self._instant_ns, kept = instant_ns, self._kept
        last_ns = instant_ns + (len(path_n) - 1) * self._tick_ns
        if last_ns <= newest_ns and abs(offset_n) < NEGLIGIBLE_N:
            self._offset_n, self._path_n, self.busy = 0.0, [], False
            return path_n
        self._path_n, self.busy = path_n, True
        joined_n = []
        for force_n in path_n:
            joined_n.append(force_n + offset_n)
            offset_n *= kept
        return joined_n

    def _offset_at(self, force_n: float, instant_ns: int) -> float:
        """Return what is left of the offset, plus the jump to this force from the last path."""
        path_n = self._path_n
        ticks = (instant_ns - self._instant_ns) / self._tick_ns
        # After missed ticks or a jump of the playout there is nothing to join.
        if not 0 < ticks < len(path_n):
            return 0.0
        before = min(int(ticks), len(path_n) - 2)
        start_n, end_n = path_n[before : before + 2]
        expected_n = start_n + (ticks - before) * (end_n - start_n)
        offset_n = self._offset_n * self._kept**ticks + expected_n - force_n
        return offset_n if math.isfinite(offset_n) else 0.0


class Concealment:
    """One session's predictor, with its jumps smoothed and its error judged. Pure.

    Forces are at the wrist, in N; times are the sensing clock's but for now_ns.
    """

    def __init__(self, predictor: PredictorName, channel: int, tick_ns: int, auto: bool) -> None:
        """auto: the perceived delay follows the link, so trust may take the delay off it."""
        self._channel = channel
        self._tick_ns = tick_ns
        self._predictor = build_predictor(predictor, tick_ns)
        self._blend = Blend(tick_ns)
        self._size = PulseSize()
        self._trust = Trust() if auto and predictor not in UNLEARNT else None

    @property
    def trusted(self) -> bool | None:
        """Whether it is trusted with all of the delay; None where the scene leaves it no say."""
        return None if self._trust is None else self._trust.trusted

    def observe(self, frame: Frame) -> None:
        """Take a frame, late or not."""
        first_ns, period_ns = frame.t_first_ns, frame.period_ns
        values = frame.values[:, self._channel].tolist()
        end_ns = first_ns + len(values) * period_ns
        self._predictor.observe(list(range(first_ns, end_ns, period_ns)), values)
        if self._trust is not None:
            self._size.observe(first_ns, values)

    def work(self) -> None:
        """Do a tick's share of the learning."""
        self._predictor.work()

    def judge(self, now_ns: int, horizon_ns: int) -> None:
        """How well it does now with all of the delay: predicting horizon_ns after the newest."""
        if self._trust is not None:
            self._trust.judge(now_ns, self.error_n(horizon_ns), self._size.size)

    def error_n(self, horizon_ns: int) -> float | None:
        """RMSE expected so far after the newest sample; None while nothing is known of it."""
        return self._predictor.error_n(horizon_ns)

    def complete(
        self, path_n: list[float], count: int, instant_ns: int, newest_ns: int
    ) -> list[float]:
        """Return the force at `count` instants a tick apart, the first instant_ns, without a jump.

        path_n: of the first of them, as received; newest_ns: the newest sample's time.
        """
        known = len(path_n)
        if known == count and not self._blend.busy:
            return path_n
        predict, tick_ns = self._predictor.predict, self._tick_ns
        path_n += [predict(instant_ns + step * tick_ns) for step in range(known, count)]
        return self._blend.apply(path_n, instant_ns, newest_ns)
