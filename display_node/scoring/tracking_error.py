"""Errors of the felt force: running RMSE, aligned and in phase (eqs 23-25), and roughness.

Reference and felt force are added as they become known, both on the sensing clock. A felt force is
scored once the reference around its instant is known. The reference is the received force in a
display, the sensed force in a demo or simulation. Equations are those of Dargahi et al. (2008).

Roughness is the energy of the felt force above 25 Hz, compared with that of the sensed force. The
pulse itself ends below 25 Hz; above are noise, and jumps caused by prediction.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from display_node.scoring.alignment import Floats, Times, compared_forces_n
from display_node.scoring.error_windows import ErrorWindowCounter
from protocol.pieces import Pieces
from protocol.summary.tables import AlignedErrors, ErrorWindow, Loop, Roughness, Summary
from protocol.wire.messages import ChannelSamples

ABOVE_HZ: Final = 25.0
# Half the filter's length. Its edge is ±14 Hz wide, and it attenuates slow parts by 70 dB.
REACH_S: Final = 0.1


class RoughnessMeter:
    """Meter of the energy above 25 Hz of felt and sensed force over the same ticks."""

    def __init__(self) -> None:
        self._kernel = np.empty(0)
        self._period_ns = 0
        self._last_ns = 0
        self._felt_n = self._sensed_n = np.empty(0)
        self._felt = self._sensed = 0.0
        self._count = 0

    def add(self, now_ns: Times, felt_n: Floats, sensed_n: Floats) -> None:
        """Add consecutive ticks, shape (n,); each call continues the last one.

        Ticks close to an unknown force (NaN) or to missing ticks are not counted.
        """
        if len(now_ns) < 2:
            return
        # Quicker than a median of numpy's.
        period_ns = int(np.sort(now_ns[1:] - now_ns[:-1])[(len(now_ns) - 1) // 2])
        # The tick's period on the sensing clock varies slightly, as that clock is corrected.
        if abs(period_ns - self._period_ns) > 0.1 * self._period_ns:
            self._period_ns, self._kernel = period_ns, high_pass(period_ns * 1e-9)
            self._felt_n = self._sensed_n = np.empty(0)
        missing = np.diff(now_ns, prepend=self._last_ns) > 1.5 * period_ns
        unknown = ~np.isfinite(felt_n)
        missing |= unknown
        felt_n = np.where(unknown, 0.0, felt_n)
        self._last_ns = int(now_ns[-1])
        felt_n = np.concatenate([self._felt_n, felt_n])
        sensed_n = np.concatenate([self._sensed_n, np.where(missing, np.nan, sensed_n)])
        keep = max(len(self._kernel) - 1, 0)
        kept = slice(max(0, len(felt_n) - keep), None)
        self._felt_n, self._sensed_n = felt_n[kept], sensed_n[kept]
        if not keep or len(felt_n) <= keep:
            return
        sensed = np.convolve(sensed_n, self._kernel, "valid")
        counted = ~np.isnan(sensed)
        felt, sensed = np.convolve(felt_n, self._kernel, "valid")[counted], sensed[counted]
        self._felt += float(felt @ felt)
        self._sensed += float(sensed @ sensed)
        self._count += len(felt)

    @property
    def roughness(self) -> Roughness:
        """Roughness so far; None before an uninterrupted 0.2 s, or if ticks are too slow."""
        ratio = self._felt / self._sensed if self._sensed else None
        return Roughness(_root(self._felt, self._count), _root(self._sensed, self._count), ratio)


def high_pass(period_s: float) -> Floats:
    """Return a symmetric high-pass above 25 Hz: an all-pass minus a windowed sinc (Blackman).

    It is empty if the sampling period is too long for 25 Hz.
    """
    if 2 * ABOVE_HZ * period_s >= 1:
        return np.empty(0)
    reach = round(REACH_S / period_s)
    t_s = np.arange(-reach, reach + 1) * period_s
    low_pass = np.sinc(2 * ABOVE_HZ * t_s) * np.blackman(2 * reach + 1)
    kernel = -low_pass / low_pass.sum()
    kernel[reach] += 1
    return np.asarray(kernel)


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
    unknown, and with it the errors of strain. film_age_ns: age of a felt force at its tick; 0
    without a real film. windows: errors and perceived delay by windows of time; empty before
    `finish`.
    """

    def __init__(self, strain_per_newton: float | None = None, film_age_ns: int = 0) -> None:
        self.strain_per_newton, self.film_age_ns = strain_per_newton, film_age_ns
        self.windows: list[ErrorWindow] = []
        # The reference in order of time, and the samples that were added since.
        self._t_ns, self._target_n = np.empty(0, np.int64), np.empty(0)
        self._added_ns: list[int] = []
        self._added_n: list[float] = []
        # Felt forces that wait for the reference, with time and played instant; their number.
        self._times_ns = np.empty((2, MOST_WAITING + BLOCK), np.int64)
        self._felt_n = np.empty(MOST_WAITING + BLOCK)
        self._waiting = 0
        self._aligned = self._in_phase = 0.0
        self._aligned_count = self._in_phase_count = 0
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

    def add_reference_force(self, t_ns: Sequence[int], target_n: Sequence[float]) -> None:
        """Add the target force at the finger for consecutive samples, late ones too."""
        self._added_ns += t_ns
        self._added_n += target_n
        if len(self._added_ns) > MAX_ADDED:
            until_ns = t_ns[-1] - KEEP_NS
            self._score_until(until_ns)
            self._gathered(until_ns)

    def add_reference(
        self, samples: ChannelSamples, force_ratio: float, group_delay_ns: int = 0
    ) -> None:
        """Add samples of the pulse, which are `group_delay_ns` behind it.

        force_ratio: target force at the finger per force at the wrist.
        """
        times_ns = samples.times_ns
        if group_delay_ns:
            times_ns = [t_ns - group_delay_ns for t_ns in times_ns]
        self.add_reference_force(times_ns, [force_ratio * force_n for force_n in samples.forces_n])

    def add_output(self, now_ns: Times, instant_ns: Times, felt_n: Floats) -> None:
        """Add felt forces in the order of time, shape (n,); NaN where one is unknown.

        now_ns, instant_ns: time of each, and instant of the pulse that is played then.
        """
        for first in range(0, len(felt_n), BLOCK):
            block, begin = slice(first, first + BLOCK), self._waiting
            self._waiting = end = begin + len(felt_n[block])
            self._times_ns[0, begin:end] = now_ns[block]
            self._times_ns[1, begin:end] = instant_ns[block]
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
        return AlignedErrors(
            _root(self._aligned, self._aligned_count), _root(self._in_phase, self._in_phase_count)
        )

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
        return self._within / self._aligned_count if self._aligned_count else None

    def add_to(self, figures: Summary, loop: Loop) -> Summary:
        """Return a contactor's figures with these; loop: of the display."""
        ticks = (loop.ticks or 0) + (loop.deadline_misses or 0)
        judged = min(1.0, self._aligned_count / ticks) if ticks else None
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
        t_ns, target_n = self._gathered(until_ns=int(instant_ns[0]) - self.film_age_ns - SPAN_NS)
        if not len(t_ns):
            return
        yield
        played_n, present_n = compared_forces_n(
            now_ns, instant_ns, self.film_age_ns, t_ns, target_n
        )
        yield
        self._roughness.add(now_ns, felt_n, played_n)
        yield
        aligned, in_phase = felt_n - played_n, felt_n - present_n
        self._by_time.add(now_ns, now_ns - instant_ns, aligned, in_phase)
        yield
        aligned, in_phase = aligned[~np.isnan(aligned)], in_phase[~np.isnan(in_phase)]
        self._aligned += float(aligned @ aligned)
        self._aligned_count += len(aligned)
        self._in_phase += float(in_phase @ in_phase)
        self._in_phase_count += len(in_phase)
        self._within += int(np.count_nonzero(np.abs(aligned) < JND * np.ptp(target_n)))

    def _gathered(self, until_ns: int) -> tuple[Times, Floats]:
        """Return the reference in order of time, after removing what is older than `until_ns`."""
        t_ns = np.concatenate([self._t_ns, np.array(self._added_ns, np.int64)])
        target_n = np.concatenate([self._target_n, np.array(self._added_n)])
        self._added_ns, self._added_n = [], []
        if (t_ns[1:] < t_ns[:-1]).any():
            order = np.argsort(t_ns, kind="stable")
            t_ns, target_n = t_ns[order], target_n[order]
        keep = max(0, int(np.searchsorted(t_ns, until_ns)) - 1)
        self._t_ns, self._target_n = t_ns[keep:], target_n[keep:]
        return self._t_ns, self._target_n


def _root(total: float, count: int) -> float | None:
    return math.sqrt(total / count) if count else None
