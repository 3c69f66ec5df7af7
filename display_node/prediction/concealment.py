"""Concealment: the force where no sample has arrived, without jumps, and trust in the predictor.

With `compensation = "auto"`, the perceived delay E is the delay that the link requires; while the
predictor is trusted, E is up to 400 ms smaller. Pure: frames, errors and times are arguments.
"""

import math
import statistics
from collections import deque

from display_node.prediction import WITHOUT_ERROR_ESTIMATE, PredictorName, build_predictor
from protocol.wire.messages import Frame

# Time constant of the decay, as a share of the horizon of the old prediction: corrections of a
# longer prediction are larger, and may take longer.
DECAY_OVER_HORIZON = 0.2
NEGLIGIBLE_N = 1e-6


class Blend:
    """Continuous transition from each tick's path of predicted force to the next tick's.

    A new frame corrects the prediction, so the force for the present instant jumps. The jump is
    removed by an offset that decays. busy: whether the last path was predicted, or an offset is
    still in effect.
    """

    def __init__(self, tick_ns: int) -> None:
        self._tick_ns = tick_ns
        self._path_n: list[float] = []
        self._instant_ns = self._newest_ns = 0
        # Horizon of the prediction that caused the offset. It at most halves with each frame, so
        # that a short horizon after a long one does not drop a large offset at once.
        self._spanned_ns = 0
        self._kept = self._offset_n = 0.0
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
        """Return the rest of the decaying offset plus the jump from the last path to this force."""
        path_n = self._path_n
        ticks = (instant_ns - self._instant_ns) / self._tick_ns
        # After missed ticks or a jump of the playout, the paths do not overlap.
        if not 0 < ticks < len(path_n):
            return 0.0
        before = min(int(ticks), len(path_n) - 2)
        start_n, end_n = path_n[before : before + 2]
        expected_n = start_n + (ticks - before) * (end_n - start_n)
        offset_n = self._offset_n * self._kept**ticks + expected_n - force_n
        return offset_n if math.isfinite(offset_n) else 0.0


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
                self._low, self._high = min(self._low, low), max(self._high, high)
                return
            self._sizes.append(self._high - self._low)
            self.size = statistics.median(self._sizes)
        self._begun_ns, self._low, self._high = t_ns, low, high


# Bounds of the RMSE as a share of the pulse's height. A finger notices differences above 7 to
# 10 %, and peak errors are 2.5 times the RMSE.
LOST_ABOVE, GAINED_BELOW = 0.04, 0.025
DWELL_NS = 10_000_000_000
MEMORY_NS = 1_500_000_000
# Larger errors count as this share, so that they are soon forgotten.
WORST = 0.3
# Greatest reduction of E by trust: above 0.5 s the playout would jump instead of slewing.
MOST_NS = 400_000_000


class Trust:
    """Judgement that the predictor's error would go unnoticed at E = 0.

    The criterion is the RMS of the expected error over the last 1.5 s, as a share of the pulse's
    height. A tick is weighted by the time since the last one; an unknown error counts as 0.3. Trust
    is lost at once from 4 % on, and gained below 2.5 %, at the earliest 10 s after a loss.
    """

    def __init__(self) -> None:
        self._power = WORST**2
        self._judged_ns: int | None = None
        self._lost_ns = 0
        self.trusted = False

    def judge(self, now_ns: int, error_n: float | None, size_n: float | None) -> None:
        """Take at each tick the RMSE in N expected if E were 0, and the pulse's height in N."""
        share = WORST
        if error_n is not None and size_n:
            share = min(error_n / size_n, WORST)
        if self._judged_ns is not None:
            weight = -math.expm1((self._judged_ns - now_ns) / MEMORY_NS)
            self._power += weight * (share * share - self._power)
        self._judged_ns = now_ns
        if self._power >= LOST_ABOVE**2:
            self.trusted, self._lost_ns = False, now_ns
        elif self._power <= GAINED_BELOW**2 and now_ns - self._lost_ns >= DWELL_NS:
            self.trusted = True


def auto_delay_ns(carried_ns: int, trusted: bool) -> int:
    """Return E for "auto", from the delay that the link requires."""
    return max(0, carried_ns - MOST_NS) if trusted else carried_ns


class Concealment:
    """One session's predictor, with smoothed jumps and a judgement of its error. Pure.

    Forces are those at the wrist, in N. Times are on the sensing clock, except now_ns. auto:
    whether the perceived delay follows the link, so that trust may reduce it.
    """

    def __init__(self, predictor: PredictorName, channel: int, tick_ns: int, auto: bool) -> None:
        self._channel, self._tick_ns = channel, tick_ns
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
        return None if self._trust is None else self._trust.trusted

    def observe(self, frame: Frame) -> None:
        """Take a frame, late or not."""
        first_ns, period_ns = frame.t_first_ns, frame.period_ns
        values = frame.values[:, self._channel].tolist()
        end_ns = first_ns + len(values) * period_ns
        self._predictor.observe(list(range(first_ns, end_ns, period_ns)), values)
        if self._trust is not None:
            self._size.observe(first_ns, values)

    def judge(self, now_ns: int, horizon_ns: int) -> None:
        """Update the trust by the expected error `horizon_ns` after the newest sample."""
        if self._trust is not None:
            self._trust.judge(now_ns, self.error_n(horizon_ns), self._size.size)

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
