"""Errors of the felt force against the pulse, aligned and in phase (eqs 23-25). Pure.

Reference and felt force are added as they become known, both on the sensing clock. A felt force is
scored once the reference around its instant is known. The reference is the force of the pulse at
the finger: the received one in a display, the sensed one in a demo or simulation, times the ratio
of the layers. Equations are those of Dargahi et al. (2008).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.error_windows import ErrorWindowCounter
from display_node.scoring.roughness import RoughnessMeter
from protocol.pieces import Pieces
from protocol.summary.fields import AlignedErrors, ErrorWindow, Loop, Summary
from protocol.wire.messages import ChannelSamples

Floats = NDArray[np.float64]
Times = NDArray[np.int64]
# Largest gap of a pulse that is interpolated; within a larger one (a cut link) no error is known.
MAX_GAP_NS: Final = 60_000_000


def compared_forces_n(
    now_ns: NDArray[Any],
    instant_ns: NDArray[Any],
    t_ns: NDArray[Any],
    reference_n: Floats,
    film_age_ns: float = 0,
) -> tuple[Floats, Floats]:
    """Return the forces with which the felt force of ticks is compared: aligned, and in phase.

    The felt force F of a tick is the film's reading, which is older than the tick by A. With the
    reference f and the playout delay E, the errors (eqs 23-25) are::

        aligned:  F − f(instant − A) = F − f(now − E − A)
        in phase: F − f(now − A)

    The aligned error is that of prediction and force loop; the one in phase has E in it as well.

    now_ns, instant_ns: time of each tick, and instant that it plays, in any shape. t_ns,
    reference_n: f in N at rising times. film_age_ns: A, 0 where the film is modelled. Forces are
    NaN where an instant is, outside of t_ns, and inside of gaps.
    """
    aligned_n, in_phase_n = interpolate(
        np.stack([instant_ns, now_ns]) - film_age_ns, t_ns, reference_n
    )
    return aligned_n, in_phase_n


def rms(errors: Floats) -> float | None:
    """Return the root mean square of the errors that are known; None without any."""
    known = errors[~np.isnan(errors)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else None


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


BLOCK: Final = 256
# A felt force waits this many ticks for the reference of its instant to arrive.
PATIENCE: Final = 2_048
# Ticks that wait at most: beyond, `add_output` scores without `work` being called.
MOST_WAITING: Final = PATIENCE + 4 * BLOCK
# Time after which a reference without a felt force (of a display at fault) is removed.
KEEP_NS: Final = 30_000_000_000
# Samples that are added one by one before they join the reference.
MAX_ADDED: Final = 8_192
JND: Final = 0.10
SPAN_NS: Final = 2_000_000_000


class TrackingError:
    """Accumulator of both errors and of the roughness.

    strain_per_newton: strain of the layer under the finger per force, in 1/N; None while it is
    unknown, and with it the errors of strain. take_scored: function that receives, of each tick
    once it is scored, the reference of the played instant (NaN where unknown) and the felt force.
    windows: errors and perceived delay by windows of time; empty before `finish`.
    """

    def __init__(
        self,
        strain_per_newton: float | None = None,
        take_scored: Callable[[Floats, Floats], None] | None = None,
    ) -> None:
        self.strain_per_newton, self._take_scored = strain_per_newton, take_scored
        self.windows: list[ErrorWindow] = []
        # The reference in order of time, and the samples that were added since.
        self._t_ns, self._reference_n = np.empty(0, np.int64), np.empty(0)
        self._added_ns: list[int] = []
        self._added_n: list[float] = []
        # Felt forces that wait for the reference, with time and played instant; their number.
        self._times_ns = np.empty((2, MOST_WAITING + BLOCK), np.int64)
        self._felt_n = np.empty(MOST_WAITING + BLOCK)
        self._waiting = 0
        self._within = 0
        self._roughness = RoughnessMeter()
        self._by_time = ErrorWindowCounter()
        # What is left of the scoring of the oldest block.
        self._pieces = Pieces()

    def work(self) -> bool:
        """Do one piece of the scoring that is due; return whether any was.

        Without calls of it, `add_output` scores in bursts.
        """
        if not self._pieces.waiting and self._waiting >= PATIENCE + BLOCK:
            self._pieces.begin(self._score_oldest())
        return self._pieces.do_one()

    def add_reference_force(self, t_ns: Sequence[int], reference_n: Sequence[float]) -> None:
        """Add the reference of consecutive samples, late ones too."""
        self._added_ns += t_ns
        self._added_n += reference_n
        if len(self._added_ns) > MAX_ADDED:
            until_ns = t_ns[-1] - KEEP_NS
            self._score_until(until_ns)
            self._gathered(until_ns)

    def add_reference(
        self, samples: ChannelSamples, force_ratio: float, group_delay_ns: int = 0
    ) -> None:
        """Add samples of the pulse, which are `group_delay_ns` behind it.

        force_ratio: force at the finger per force at the wrist.
        """
        times_ns = samples.times_ns
        if group_delay_ns:
            times_ns = [t_ns - group_delay_ns for t_ns in times_ns]
        self.add_reference_force(times_ns, [force_ratio * force_n for force_n in samples.forces_n])

    def add_output(
        self, now_ns: Times, instant_ns: Times, felt_n: Floats, film_age_ns: int = 0
    ) -> None:
        """Add felt forces in the order of time, shape (n,); NaN where one is unknown.

        now_ns, instant_ns: time of each tick, and instant of the pulse that it plays. film_age_ns:
        age of the felt forces at their ticks; 0 without a real film.
        """
        for first in range(0, len(felt_n), BLOCK):
            block, begin = slice(first, first + BLOCK), self._waiting
            self._waiting = end = begin + len(felt_n[block])
            # From here on both are of the time at which the film was read.
            self._times_ns[0, begin:end] = now_ns[block] - film_age_ns
            self._times_ns[1, begin:end] = instant_ns[block] - film_age_ns
            self._felt_n[begin:end] = felt_n[block]
            if end >= MOST_WAITING:
                while self.work():
                    pass

    def finish(self) -> None:
        """Score the remaining felt forces."""
        self._score_until(None)
        self.windows = self._by_time.windows()

    @property
    def force_rmse_n(self) -> AlignedErrors:
        """RMSE of the force, in N."""
        return self._by_time.force_rmse_n

    @property
    def strain_rmse(self) -> AlignedErrors:
        """RMSE of the strain: that of the force, converted by the local layer."""
        force, factor = self.force_rmse_n, self.strain_per_newton
        if factor is None:
            return AlignedErrors()
        errors = (force.aligned, force.in_phase)
        return AlignedErrors(*(None if error is None else error * abs(factor) for error in errors))

    @property
    def within_jnd(self) -> float | None:
        """Share of the judged time with an error below 10 % of the pulse's peak to peak."""
        judged = self._by_time.judged_ticks
        return self._within / judged if judged else None

    def add_to(self, figures: Summary, loop: Loop) -> Summary:
        """Return a contactor's figures with these; loop: of the display."""
        ticks = (loop.ticks or 0) + (loop.deadline_misses or 0)
        judged = min(1.0, self._by_time.judged_ticks / ticks) if ticks else None
        return replace(
            figures,
            force_rmse_n=self.force_rmse_n,
            strain_rmse=self.strain_rmse,
            within_jnd=self.within_jnd,
            windows=self.windows,
            availability=replace(figures.availability, judged=judged),
            roughness=self._roughness.roughness,
        )

    def _score_until(self, until_ns: int | None) -> None:
        """Score at once what was felt of instants before a time; None is the end of time."""
        self._pieces.finish()
        while self._waiting and (until_ns is None or self._times_ns[1, 0] < until_ns):
            self._pieces.begin(self._score_oldest())
            self._pieces.finish()

    def _score_oldest(self) -> Iterator[None]:
        """Score the oldest block, piece by piece."""
        count = min(self._waiting, BLOCK)
        (now_ns, instant_ns), felt_n = self._times_ns[:, :count].copy(), self._felt_n[:count].copy()
        self._times_ns[:, : self._waiting - count] = self._times_ns[:, count : self._waiting]
        self._felt_n[: self._waiting - count] = self._felt_n[count : self._waiting]
        self._waiting -= count
        t_ns, reference_n = self._gathered(until_ns=int(instant_ns[0]) - SPAN_NS)
        yield
        played_n, present_n = compared_forces_n(now_ns, instant_ns, t_ns, reference_n)
        if self._take_scored is not None:
            self._take_scored(played_n, felt_n)
        if not len(t_ns):
            return
        yield
        self._roughness.add(now_ns, felt_n, played_n)
        yield
        aligned, in_phase = felt_n - played_n, felt_n - present_n
        self._by_time.add(now_ns, now_ns - instant_ns, aligned, in_phase)
        self._within += int(np.count_nonzero(np.abs(aligned) < JND * np.ptp(reference_n)))

    def _gathered(self, until_ns: int) -> tuple[Times, Floats]:
        """Return the reference in order of time, after removing what is older than `until_ns`."""
        t_ns = np.concatenate([self._t_ns, np.array(self._added_ns, np.int64)])
        reference_n = np.concatenate([self._reference_n, np.array(self._added_n)])
        self._added_ns, self._added_n = [], []
        if (t_ns[1:] < t_ns[:-1]).any():
            order = np.argsort(t_ns, kind="stable")
            t_ns, reference_n = t_ns[order], reference_n[order]
        keep = max(0, int(np.searchsorted(t_ns, until_ns)) - 1)
        self._t_ns, self._reference_n = t_ns[keep:], reference_n[keep:]
        return self._t_ns, self._reference_n
