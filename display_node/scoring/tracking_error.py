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
from numpy.typing import NDArray

from display_node.scoring.error_windows import ErrorWindowCounter
from protocol.pieces import Pieces
from protocol.summary.tables import AlignedErrors, ErrorWindow, Roughness, Summary
from protocol.wire.messages import ChannelSamples

ABOVE_HZ: Final = 25.0
# Half the filter's length. Its edge is ±14 Hz wide, and it attenuates slow parts by 70 dB.
REACH_S: Final = 0.1
Floats = NDArray[np.float64]
Times = NDArray[np.int64]


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
# Largest gap of the reference that is interpolated; a larger one (a cut link) is not scored.
MAX_GAP_NS: Final = 60_000_000
JND: Final = 0.10
SPAN_NS: Final = 2_000_000_000


class TrackingError:
    """Accumulator of both errors and of the roughness.

    strain_per_newton: strain of the layer under the finger per force, in 1/N; None while it is
    unknown, and with it the errors of strain.
    """

    def __init__(self, strain_per_newton: float | None = None) -> None:
        self.strain_per_newton = strain_per_newton
        # The reference in order of time, and the samples that were added since.
        self._t_ns, self._target_n = np.empty(0, np.int64), np.empty(0)
        self._added_ns: list[int] = []
        self._added_n: list[float] = []
        # Felt forces that wait for the reference.
        self._now_ns: list[int] = []
        self._instant_ns: list[int] = []
        self._felt_n: list[float] = []
        self._aligned = self._in_phase = 0.0
        self._aligned_count = self._in_phase_count = 0
        self._within = 0
        self._roughness = RoughnessMeter()
        self._windows = ErrorWindowCounter()
        # What is left of the scoring of the oldest block.
        self._pieces = Pieces()

    def work(self) -> bool:
        """Do one piece of the scoring that is due; return whether any was.

        Without calls of it, `add_output` scores in bursts.
        """
        if not self._pieces.waiting and len(self._felt_n) >= PATIENCE + BLOCK:
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

    def add_output(self, now_ns: int, instant_ns: int, force_n: float) -> None:
        """Add the felt force at `now_ns`, when `instant_ns` is played; NaN where it is unknown."""
        self._now_ns.append(now_ns)
        self._instant_ns.append(instant_ns)
        self._felt_n.append(force_n)
        if len(self._felt_n) >= MOST_WAITING:
            while self.work():
                pass

    def finish(self) -> None:
        """Score the remaining felt forces."""
        self._score_until(None)

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

    @property
    def windows(self) -> list[ErrorWindow]:
        """Errors and perceived delay by windows of time."""
        return self._windows.windows()

    def scored(self, figures: Summary, ticks: int) -> Summary:
        """Return a contactor's figures with errors, roughness and the share of `ticks` judged."""
        judged = min(1.0, self._aligned_count / ticks) if ticks else None
        return replace(
            figures,
            force_rmse_n=self.force_rmse_n,
            strain_rmse=self.strain_rmse,
            within_jnd=self.within_jnd,
            availability=replace(figures.availability, judged=judged),
            roughness=self._roughness.roughness,
        )

    def _score_until(self, until_ns: int | None) -> None:
        """Score at once what was felt of instants before a time; None is the end of time."""
        self._pieces.finish()
        while self._felt_n and (until_ns is None or self._instant_ns[0] < until_ns):
            self._pieces.begin(self._score_oldest())
            self._pieces.finish()

    def _score_oldest(self) -> Iterator[None]:
        """Score the oldest block, piece by piece."""
        now_ns = np.array(self._now_ns[:BLOCK])
        instant_ns = np.array(self._instant_ns[:BLOCK])
        felt_n = np.array(self._felt_n[:BLOCK])
        del self._now_ns[:BLOCK], self._instant_ns[:BLOCK], self._felt_n[:BLOCK]
        t_ns, target_n = self._gathered(until_ns=int(instant_ns[0]) - SPAN_NS)
        if not len(t_ns):
            return
        yield
        at_ns = np.concatenate([instant_ns, now_ns])
        sensed_n, present_n = interpolate(at_ns, t_ns, target_n).reshape(2, -1)
        yield
        self._roughness.add(now_ns, felt_n, sensed_n)
        yield
        aligned, in_phase = felt_n - sensed_n, felt_n - present_n
        self._windows.add(now_ns, now_ns - instant_ns, aligned, in_phase)
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


def interpolate(at_ns: Times, t_ns: Times, values: Floats) -> Floats:
    """Interpolate linearly; NaN outside of t_ns and inside of gaps."""
    if len(t_ns) < 2:
        return np.full(len(at_ns), np.nan)
    right = np.searchsorted(t_ns, at_ns, side="right")
    inside = (right > 0) & (right < len(t_ns))
    right = np.clip(right, 1, len(t_ns) - 1)
    gap_ns = t_ns[right] - t_ns[right - 1]
    share = (at_ns - t_ns[right - 1]) / np.maximum(gap_ns, 1)
    result: Floats = values[right - 1] + share * (values[right] - values[right - 1])
    result[~inside | (gap_ns > MAX_GAP_NS)] = np.nan
    return result


def _root(total: float, count: int) -> float | None:
    return math.sqrt(total / count) if count else None


def scored(summary: Summary, errors: Sequence[TrackingError], windows: bool = False) -> Summary:
    """Return a display's summary with the errors of its contactors, in their order.

    errors: none where the finger presses back. windows: whether to add the errors by time.
    """
    if not errors:
        return summary
    ticks = (summary.loop.ticks or 0) + (summary.loop.deadline_misses or 0)
    found = {
        name: error.scored(figures, ticks)
        for (name, figures), error in zip(summary.of_each_contactor().items(), errors, strict=True)
    }
    if windows:
        found = {
            name: replace(figures, windows=error.windows)
            for (name, figures), error in zip(found.items(), errors, strict=True)
        }
    return replace(summary, contactors=found) if summary.contactors else found[""]
