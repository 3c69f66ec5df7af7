"""Concealment: the force where no sample has arrived, without jumps, and trust in the predictor.

With `compensation = "auto"`, the perceived delay E is the delay that the link requires; while the
predictor is trusted, E is up to 400 ms smaller. Pure: samples, errors and times are arguments.
"""

import math

from display_node.prediction import WITHOUT_ERROR_ESTIMATE, PredictorName, build_predictor
from display_node.prediction.trust import PulseSize, Trust
from protocol.wire.messages import ChannelSamples

# Time constant of the decay, as a share of the horizon of the old prediction: corrections of a
# longer prediction are larger, and may take longer.
DECAY_OVER_HORIZON = 0.2
NEGLIGIBLE_N = 1e-6


class Blend:
    """Continuous transition from each tick's path of predicted force to the next tick's.

    A new frame corrects the prediction, so the force for the present instant jumps. The jump is
    removed by an offset that decays. offset_n: its present value. busy: whether the last path was
    predicted, or an offset is still in effect.
    """

    def __init__(self, tick_ns: int) -> None:
        self._tick_ns = tick_ns
        self._path_n: list[float] = []
        self._instant_ns = self._newest_ns = 0
        # Horizon of the prediction that caused the offset. It at most halves with each frame, so
        # that a short horizon after a long one does not drop a large offset at once.
        self._spanned_ns = 0
        self._kept = self.offset_n = 0.0
        self.busy = False

    def apply(self, path_n: list[float], instant_ns: int, newest_ns: int) -> list[float]:
        """Return the path without the jump from the last one.

        Parameters
        ----------
        path_n
            Force in N at `instant_ns` and at the ticks after it. While not `busy`, at least the
            last value is a prediction.
        newest_ns
            Time of the newest sample in ns.
        """
        if newest_ns != self._newest_ns:
            self._spanned_ns = max(self._instant_ns - self._newest_ns, self._spanned_ns // 2)
            decay_ticks = DECAY_OVER_HORIZON * self._spanned_ns / self._tick_ns
            self._kept = math.exp(-1 / decay_ticks) if decay_ticks > 0 else 0.0
            self._newest_ns = newest_ns
        self.offset_n = offset_n = self._offset_at(path_n[0], instant_ns)
        self._instant_ns, kept = instant_ns, self._kept
        last_ns = instant_ns + (len(path_n) - 1) * self._tick_ns
        if last_ns <= newest_ns and abs(offset_n) < NEGLIGIBLE_N:
            self.offset_n, self._path_n, self.busy = 0.0, [], False
            return path_n
        self._path_n, self.busy = path_n, True
        joined_n = []
        for force_n in path_n:
            joined_n.append(force_n + offset_n)
            offset_n *= kept
        return joined_n

    def _offset_at(self, force_n: float, instant_ns: int) -> float:
        """Return the rest of the decaying offset plus the jump from the last path to this force."""
        path_n = self._path_n
        ticks = (instant_ns - self._instant_ns) / self._tick_ns
        # After missed ticks or a jump of the playout, the paths do not overlap.
        if not 0 < ticks < len(path_n):
            return 0.0
        before = min(int(ticks), len(path_n) - 2)
        start_n, end_n = path_n[before : before + 2]
        expected_n = start_n + (ticks - before) * (end_n - start_n)
        offset_n = self.offset_n * self._kept**ticks + expected_n - force_n
        return offset_n if math.isfinite(offset_n) else 0.0


class Concealment:
    """One session's predictor, with smoothed jumps and a judgement of its error. Pure.

    Forces are those at the wrist, in N. Times are on the sensing clock, except now_ns. auto:
    whether the perceived delay follows the link, so that trust may reduce it.
    """

    def __init__(self, predictor: PredictorName, tick_ns: int, auto: bool) -> None:
        self._tick_ns = tick_ns
        self._predictor = build_predictor(predictor, tick_ns)
        self._blend = Blend(tick_ns)
        self._size = PulseSize()
        self._trust = Trust() if auto and predictor not in WITHOUT_ERROR_ESTIMATE else None
        self.work = self._predictor.work
        self.error_n = self._predictor.error_n

    @property
    def trusted(self) -> bool | None:
        """True while the predictor's error is small enough to reduce E.

        None where trust is not used: E is fixed, or the predictor does not estimate its error.
        """
        return None if self._trust is None else self._trust.given

    @property
    def height_n(self) -> float | None:
        """The pulse's height from foot to peak in N; None while unknown."""
        return self._size.size

    @property
    def offset_n(self) -> float:
        """The part of the last force that the blend removes, in N."""
        return self._blend.offset_n

    @property
    def acts(self) -> bool:
        """True while the force is predicted, or is still blended into the received one."""
        return self._blend.busy

    def observe(self, samples: ChannelSamples) -> None:
        """Take the samples of a frame, late or not."""
        self._predictor.observe(samples.times_ns, samples.forces_n)
        self._size.observe(samples.times_ns[0], samples.forces_n)

    def delay_ns(self, now_ns: int, required_ns: int, age_ns: int) -> int:
        """Return the perceived delay E for "auto", once a tick.

        Parameters
        ----------
        required_ns
            Delay that the link requires without prediction.
        age_ns
            Age of the newest sample that has arrived, at the end of the loop's horizon.
        """
        trust = self._trust
        if trust is None:
            return required_ns
        if trust.observe(now_ns, age_ns):
            trust.evaluate(now_ns, required_ns, self._predictor.squares_n2, self._size.size)
        return trust.delay_ns(required_ns)

    def complete(
        self, path_n: list[float], count: int, instant_ns: int, newest_ns: int
    ) -> list[float]:
        """Return the force at `count` instants, one a tick from instant_ns on, without a jump.

        Parameters
        ----------
        path_n
            Received force in N at the first of these instants; it is completed in place.
        newest_ns
            Time of the newest sample.
        """
        known = len(path_n)
        if known == count and not self._blend.busy:
            return path_n
        predict, tick_ns = self._predictor.predict, self._tick_ns
        path_n += [predict(instant_ns + step * tick_ns) for step in range(known, count)]
        return self._blend.apply(path_n, instant_ns, newest_ns)
