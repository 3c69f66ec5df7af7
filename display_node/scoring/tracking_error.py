"""Errors of the felt force against the pulse, aligned and in phase (eqs 23-25). Pure.

The pulse is the force at the finger that equals the one at the wrist: the received force in a
display, the sensed one in a demo or simulation, times the ratio of the layers. Pulse and felt force
are added as they become known. A tick is judged once the pulse around its instant is known.
Equations are those of Dargahi et al. (2008).

Of a tick, `now_ns` is the time on the display's clock, `sensing_ns` the same time on the sensing
clock, and `instant_ns` the instant of the pulse that it plays, on the sensing clock.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.error_sums import ErrorSums
from display_node.scoring.roughness import RoughnessMeter
from display_node.scoring.waiting_ticks import BLOCK, BLOCK_NS, WaitingTicks
from protocol.pieces import Pieces
from protocol.summary.fields import ErrorWindow, Loop, RmsErrors, Summary
from protocol.tactile import JND
from protocol.wire.messages import ChannelSamples

Floats = NDArray[np.float64]
Times = NDArray[np.int64]
# Largest gap of a pulse that is interpolated; within a larger one (a cut link) no error is known.
MAX_GAP_NS: Final = 60_000_000
# The pulse's peak to peak is taken over this time or more.
SPAN_NS: Final = 2_000_000_000


def jnd_n(pulse_n: Floats) -> float:
    """Return the just noticeable difference of some seconds of the pulse, which has no NaN.

    It is NaN without any pulse.
    """
    return JND * float(np.ptp(pulse_n)) if len(pulse_n) else math.nan


def compared_forces_n(
    sensing_ns: NDArray[Any],
    instant_ns: NDArray[Any],
    t_ns: NDArray[Any],
    pulse_n: Floats,
    film_age_ns: float = 0,
) -> tuple[Floats, Floats]:
    """Return the forces with which the felt force of ticks is compared: aligned, and in phase.

    The felt force F of a tick is the film's reading, which is older than the tick by A. With the
    pulse f, the sensing clock s and the playout delay E, the errors (eqs 23-25) are::

        aligned:  F − f(instant − A) = F − f(s − E − A)
        in phase: F − f(s − A)

    The aligned error is that of prediction and force loop; the one in phase has E in it as well.

    sensing_ns, instant_ns: time of each tick, and instant that it plays, in any shape. t_ns,
    pulse_n: f in N at rising times. film_age_ns: A, 0 where the film is modelled. Forces are NaN
    where an instant is, outside of t_ns, and inside of gaps.
    """
    aligned_n, in_phase_n = interpolate(
        np.stack([instant_ns, sensing_ns]) - film_age_ns, t_ns, pulse_n
    )
    return aligned_n, in_phase_n


def interpolate(at_ns: NDArray[Any], t_ns: NDArray[Any], values: Floats) -> Floats:
    """Interpolate linearly; NaN outside of t_ns and inside of gaps."""
    if not len(t_ns):
        return np.full(np.shape(at_ns), np.nan)
    found = np.searchsorted(t_ns, at_ns, side="right") - 1
    left = np.maximum(found, 0)
    left_ns, left_value = t_ns[left], values[left]
    # At its own time a value holds whatever follows: a gap, or an unknown value.
    right = np.minimum(left + (at_ns > left_ns), len(t_ns) - 1)
    gap_ns = t_ns[right] - left_ns
    share = (at_ns - left_ns) / np.maximum(gap_ns, 1)
    result: Floats = left_value + share * (values[right] - left_value)
    result[(found < 0) | (at_ns > t_ns[-1]) | (gap_ns > MAX_GAP_NS)] = np.nan
    return result


# A block of felt forces waits this long for the pulse of its instants, and over a slow link until
# the pulse at its last tick has arrived, but no longer than `LONGEST_NS`.
PATIENCE_NS: Final = 2_048_000_000
LONGEST_NS: Final = 10_000_000_000
# Beyond `PATIENCE_NS` by this, `add_output` judges a due block without `work` being called.
OVERDUE_NS: Final = 3 * BLOCK_NS
# Time after which a pulse without a felt force (of a display at fault) is removed. Times of a
# session begin so long after those of the one before.
KEEP_NS: Final = 30_000_000_000
# Samples that are added one by one before they join the pulse.
MAX_ADDED: Final = 8_192


class TrackingError:
    """Accumulator of both errors and of the roughness.

    strain_per_newton: strain of the layer under the finger per force, in 1/N; None while it is
    unknown, and with it the errors of strain. take_compared: function that receives, of each block
    of ticks in their order, the pulse of the played instant (NaN where unknown), the felt force,
    and the just noticeable difference of the block, which is NaN without any pulse. windows:
    errors and perceived delay by windows of time. `add_to` puts them into every summary; they are
    empty in those before `finish`.
    """

    def __init__(
        self,
        strain_per_newton: float | None = None,
        take_compared: Callable[[Floats, Floats, float], None] | None = None,
    ) -> None:
        self.strain_per_newton, self._take_compared = strain_per_newton, take_compared
        self.windows: list[ErrorWindow] = []
        self._film_age_ns = 0
        # What is added to the times of the session, None before its first; the latest time of all.
        self._ahead_ns: int | None = 0
        self._latest_ns: int | None = None
        # The pulse in order of time, and the samples that were added since.
        self._t_ns, self._pulse_n = np.empty(0, np.int64), np.empty(0)
        self._added_ns: list[int] = []
        self._added_n: list[float] = []
        # Time of the newest pulse.
        self._pulse_until_ns: int | None = None
        self._waiting = WaitingTicks()
        self._within = 0
        self._roughness = RoughnessMeter()
        self._sums = ErrorSums()
        # What is left of the judging of the oldest block.
        self._pieces = Pieces()

    def begin_session(self, film_age_ns: int = 0) -> None:
        """Begin a session, whose sensing clock is unrelated to the one before.

        Ticks of the session before that still wait are judged by its pulse. film_age_ns: age of
        the felt forces at their ticks; 0 without a real film.
        """
        self._film_age_ns, self._ahead_ns = film_age_ns, None

    def work(self) -> bool:
        """Do one piece of the judging that is due; return whether any was.

        Without calls of it, `add_output` judges a block at once.
        """
        if not self._pieces.waiting and self._is_due(PATIENCE_NS):
            self._pieces.begin(self._judge_oldest())
        return self._pieces.do_one()

    def add_pulse(self, t_ns: Sequence[int], pulse_n: Sequence[float]) -> None:
        """Add the pulse at the finger at consecutive times of the sensing clock, late ones too."""
        if not t_ns:
            return
        if ahead_ns := self._session_ahead_ns(t_ns[0]):
            t_ns = [each_ns + ahead_ns for each_ns in t_ns]
        self._latest_ns = max(self._latest_ns or t_ns[-1], t_ns[-1])
        self._pulse_until_ns = max(self._pulse_until_ns or t_ns[-1], t_ns[-1])
        self._added_ns += t_ns
        self._added_n += pulse_n
        if len(self._added_ns) > MAX_ADDED:
            until_ns = t_ns[-1] - KEEP_NS
            self._judge_until(until_ns)
            self._gathered(until_ns)

    def add_samples(
        self, samples: ChannelSamples, force_ratio: float, group_delay_ns: int = 0
    ) -> None:
        """Add samples of the pulse, which are `group_delay_ns` behind it.

        force_ratio: force at the finger per force at the wrist.
        """
        times_ns = samples.times_ns
        if group_delay_ns:
            times_ns = [t_ns - group_delay_ns for t_ns in times_ns]
        self.add_pulse(times_ns, [force_ratio * force_n for force_n in samples.forces_n])

    def add_output(
        self, now_ns: Times, sensing_ns: Times, instant_ns: Times, felt_n: Floats
    ) -> None:
        """Add felt forces in the order of time, shape (n,); NaN where one is unknown.

        now_ns, sensing_ns: time of each tick on the display's clock, and on the sensing clock.
        instant_ns: instant of the pulse that it plays.
        """
        if not len(felt_n):
            return
        ahead_ns = self._session_ahead_ns(int(sensing_ns[0]))
        latest_ns = int(sensing_ns[-1]) + ahead_ns
        self._latest_ns = max(self._latest_ns or latest_ns, latest_ns)
        times_ns = np.stack([now_ns, sensing_ns + ahead_ns, instant_ns + ahead_ns])
        for first in range(0, len(felt_n), BLOCK):
            ticks = slice(first, first + BLOCK)
            self._waiting.add(times_ns[:, ticks], felt_n[ticks])
            if self._is_due(PATIENCE_NS + OVERDUE_NS):
                # One for each that is added: the queue does not grow, and no call takes long.
                self._judge_now()

    def finish(self) -> None:
        """Judge the remaining felt forces."""
        self._judge_until(None)
        self.windows = self._sums.windows()

    @property
    def force_rmse_n(self) -> RmsErrors:
        """RMSE of the force, in N."""
        return self._sums.force_rmse_n

    @property
    def strain_rmse(self) -> RmsErrors:
        """RMSE of the strain: that of the force, converted by the local layer."""
        force, factor = self.force_rmse_n, self.strain_per_newton
        if factor is None:
            return RmsErrors()
        errors = (force.aligned, force.in_phase)
        return RmsErrors(*(None if error is None else error * abs(factor) for error in errors))

    @property
    def within_jnd(self) -> float | None:
        """Share of the judged time with an error below 10 % of the pulse's peak to peak."""
        judged = self._sums.judged_ticks
        return self._within / judged if judged else None

    def add_to(self, figures: Summary, loop: Loop) -> Summary:
        """Return a contactor's figures with these; loop: of the display."""
        ticks = (loop.ticks or 0) + (loop.deadline_misses or 0)
        judged = min(1.0, self._sums.judged_ticks / ticks) if ticks else None
        return replace(
            figures,
            force_rmse_n=self.force_rmse_n,
            strain_rmse=self.strain_rmse,
            within_jnd=self.within_jnd,
            windows=self.windows,
            availability=replace(figures.availability, judged=judged),
            roughness=self._roughness.roughness,
        )

    def _session_ahead_ns(self, first_ns: int) -> int:
        """Return what is added to the times of this session, of which `first_ns` may be the first.

        It puts them after all of the sessions before.
        """
        if self._ahead_ns is None:
            latest_ns = self._latest_ns
            self._ahead_ns = 0 if latest_ns is None else latest_ns + KEEP_NS - first_ns
        return self._ahead_ns

    def _judge_until(self, until_ns: int | None) -> None:
        """Judge at once what was felt of instants before a time; None is the end of time."""
        self._pieces.finish()
        while (first_ns := self._waiting.first_instant_ns) is not None:
            if until_ns is not None and first_ns >= until_ns:
                return
            self._judge_now()

    def _judge_now(self) -> None:
        """Judge the oldest block at once, after what is left of the one before."""
        self._pieces.finish()
        self._pieces.begin(self._judge_oldest())
        self._pieces.finish()

    def _is_due(self, patience_ns: int) -> bool:
        """Return whether the oldest block has waited for so long, and has no reason to wait on."""
        oldest = self._waiting.oldest
        if oldest is None:
            return False
        waited_ns = self._waiting.newest_ns - oldest.last_now_ns
        if waited_ns < patience_ns:
            return False
        until_ns = self._pulse_until_ns
        arrived = until_ns is not None and until_ns >= oldest.last_sensing_ns
        return arrived or waited_ns >= LONGEST_NS

    def _judge_oldest(self) -> Iterator[None]:
        """Judge the oldest block, piece by piece."""
        age_ns, block = self._film_age_ns, self._waiting.take()
        (now_ns, sensing_ns, instant_ns), felt_n = block.times_ns, block.felt_n
        t_ns, pulse_n = self._gathered(until_ns=int(instant_ns[0]) - age_ns - SPAN_NS)
        yield
        played_n, present_n = compared_forces_n(sensing_ns, instant_ns, t_ns, pulse_n, age_ns)
        # Without what the next session may have begun with.
        noticeable_n = jnd_n(pulse_n[: np.searchsorted(t_ns, sensing_ns[-1] + KEEP_NS // 2)])
        if self._take_compared is not None:
            self._take_compared(played_n, felt_n, noticeable_n)
        if not len(t_ns):
            return
        yield
        self._roughness.add(now_ns, felt_n, played_n)
        yield
        aligned_n, in_phase_n = felt_n - played_n, felt_n - present_n
        self._sums.add(now_ns, sensing_ns - instant_ns, aligned_n, in_phase_n)
        self._within += int(np.count_nonzero(np.abs(aligned_n) < noticeable_n))

    def _gathered(self, until_ns: int) -> tuple[Times, Floats]:
        """Return the pulse in order of time, after removing what is older than `until_ns`."""
        t_ns = np.concatenate([self._t_ns, np.array(self._added_ns, np.int64)])
        pulse_n = np.concatenate([self._pulse_n, np.array(self._added_n)])
        self._added_ns, self._added_n = [], []
        if (t_ns[1:] < t_ns[:-1]).any():
            order = np.argsort(t_ns, kind="stable")
            t_ns, pulse_n = t_ns[order], pulse_n[order]
        keep = max(0, int(np.searchsorted(t_ns, until_ns)) - 1)
        self._t_ns, self._pulse_n = t_ns[keep:], pulse_n[keep:]
        return self._t_ns, self._pulse_n
