"""Score of the prediction that was felt: its error, and the corrections that were noticeable. Pure.

The error is that of the predicted force, as it was felt, at the instants of samples that arrive
later. A correction is the offset that the blend removes after a new sample has shown the prediction
to be wrong. Both are noticeable from the just noticeable difference on, 10 % of the pulse's height.
"""

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from protocol.summary.fields import Compensation
from protocol.tactile import JND
from protocol.wire.messages import ChannelSamples

# Predicted ticks that wait for their samples: 4 s at 1 kHz. Later samples are not scored.
KEEP_TICKS: Final = 4_096
WINDOW_NS: Final = 5_000_000_000
# The alarm begins when the prediction was noticeably wrong for more than this share of the window,
# and ends below half of it. One early beat takes some 7 %.
ALARM_SHARE: Final = 0.10


def prediction_alarm(compensation: Mapping[str, Any]) -> str | None:
    """Return the text of the alarm of a summary's `compensation`; None while it is off."""
    if not compensation.get("alarm"):
        return None
    noticed = compensation.get("noticed_5s")
    # Statuses of other programs may lack this figure.
    share = "too much" if noticed is None else f"{100 * noticed:.1f} %"
    return (
        f"the predicted force was off by more than {100 * JND:.0f} % of the pulse's height for"
        f" {share} of the last 5 s, which a finger notices"
    )


class PredictionScore:
    """Score over all sessions of a run. Times are on the sensing clock.

    corrections: how often a correction began to be noticeable. alarm: whether the prediction was
    noticeably wrong for more than 10 % of the last 5 s; it stays on until less than 5 %.
    """

    def __init__(self, tick_ns: int) -> None:
        # A longer time between two ticks, after missed ones, is not interpolated.
        self._most_apart_ns = 2 * tick_ns
        self._times: list[int] = []
        self._forces_n: list[float] = []
        self._corrected = False
        # Sums of squares: of the error in N, and of its share of the pulse's height.
        self._squares_n2 = self._squares = 0.0
        self._count = self._sized_count = 0
        # Noticeable errors of the window: time of a frame, and time that its samples last.
        self._noticed: deque[tuple[int, int]] = deque()
        self._noticed_ns = 0
        self.corrections = 0
        self.alarm = False

    def restart(self) -> None:
        """Discard what waits for samples, because their times belong to another clock."""
        self._times.clear()
        self._forces_n.clear()
        self._noticed.clear()
        self._noticed_ns = 0
        self._corrected = self.alarm = False

    def add_output(
        self, t_ns: int, force_n: float, offset_n: float, height_n: float | None, full: bool
    ) -> None:
        """Add a tick whose force was predicted, or is still blended into the received one.

        Parameters
        ----------
        t_ns
            Time of the sample that shows the played instant; such times rise by a tick each.
        force_n
            Force at the wrist that was played, in N, the blend's offset included.
        offset_n
            The part of it that the blend removes.
        height_n
            The pulse's height from foot to peak; None while unknown.
        full
            Whether the pulse is felt at full strength; a ramp or a fade hides corrections.
        """
        times = self._times
        if times and t_ns <= times[-1]:
            # The playout has jumped back.
            times.clear()
            self._forces_n.clear()
        times.append(t_ns)
        self._forces_n.append(force_n)
        if len(times) > 2 * KEEP_TICKS:
            del times[:KEEP_TICKS], self._forces_n[:KEEP_TICKS]
        corrected = height_n is not None and abs(offset_n) > JND * height_n
        self.corrections += corrected and full and not self._corrected
        self._corrected = corrected

    def add_samples(
        self, samples: ChannelSamples, force_ratio: float, height_n: float | None
    ) -> None:
        """Add received samples: the true force at those of their instants that were predicted.

        force_ratio: force at the finger per force at the wrist.
        """
        times, first_ns = self._times, samples.times_ns[0]
        if self._noticed:
            self._forget(first_ns)
        if not times or first_ns > times[-1]:
            return
        square = 0.0
        count = noticed = 0
        noticeable_n = math.inf if height_n is None else JND * height_n
        for error_n in self._errors_n(samples):
            square += error_n * error_n
            count += 1
            noticed += abs(error_n) > noticeable_n
        self._squares_n2 += force_ratio * force_ratio * square
        self._count += count
        if height_n:
            self._squares += square / (height_n * height_n)
            self._sized_count += count
        if noticed:
            noticed_ns = noticed * samples.period_ns
            self._noticed.append((first_ns, noticed_ns))
            self._noticed_ns += noticed_ns
            self.alarm = self.alarm or self.noticed_5s > ALARM_SHARE

    @property
    def noticed_5s(self) -> float:
        """Share of the last 5 s for which the prediction was noticeably wrong."""
        return min(1.0, self._noticed_ns / WINDOW_NS)

    def add_to(self, compensation: Compensation, played_s: float) -> Compensation:
        """Return the table with these scores; played_s: time for which a pulse was played.

        Without anything to score, the scores stay null.
        """
        if not played_s or not (self._count or self.corrections):
            return compensation
        return replace(
            compensation,
            error_n=_root(self._squares_n2, self._count),
            error_share=_root(self._squares, self._sized_count),
            corrections=self.corrections,
            corrections_per_min=60 * self.corrections / played_s,
            alarm=self.alarm,
            noticed_5s=self.noticed_5s,
        )

    def _errors_n(self, samples: ChannelSamples) -> list[float]:
        """Return the errors at the instants that were predicted on both sides."""
        times, forces_n = self._times, self._forces_n
        errors_n: list[float] = []
        after, length = bisect_left(times, samples.times_ns[0]), len(times)
        for t_ns, true_n in zip(samples.times_ns, samples.forces_n, strict=True):
            while after < length and times[after] < t_ns:
                after += 1
            if after == length:
                break
            if times[after] == t_ns:
                errors_n.append(forces_n[after] - true_n)
            elif after:
                before_ns, before_n = times[after - 1], forces_n[after - 1]
                apart_ns = times[after] - before_ns
                if apart_ns <= self._most_apart_ns:
                    share = (t_ns - before_ns) / apart_ns
                    errors_n.append(before_n + share * (forces_n[after] - before_n) - true_n)
        return errors_n

    def _forget(self, t_ns: int) -> None:
        noticed = self._noticed
        while noticed and noticed[0][0] <= t_ns - WINDOW_NS:
            self._noticed_ns -= noticed.popleft()[1]
        self.alarm = self.alarm and self.noticed_5s >= ALARM_SHARE / 2


def _root(total: float, count: int) -> float | None:
    return math.sqrt(total / count) if count else None
