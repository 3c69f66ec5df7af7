"""A contactor in a recording: trends in fixed memory, forces at wrist and finger, and its beats.

Errors, blocks for plots, and heart rates are computed from the forces. Pure.
"""

import math
from collections import defaultdict
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.beat_statistics import BeatStatistics
from display_node.scoring.heart_rate import heart_rate_per_min
from display_node.scoring.tracking_error import JND, TrackingError, interpolate
from protocol.wire.messages import Frame
from protocol.wire.stream import StreamDescription

# BLOCK ticks are aligned at once. They wait for the samples around their instants until PATIENCE
# further ticks have come, as in the display.
BLOCK = PATIENCE = 2_048
MAX_FRAMES = 20_000
# Heart rates use every tenth tick, which gives enough points in a beat.
THIN = 10
HEART_WINDOW_S = 6.0
# A window with a longer gap has no heart rate.
MAX_GAP_S = 0.25
# Blocks that are kept from the start.
FIRST_BLOCKS = 3
# Bins of a trend, and their initial width.
BINS = 1_000
NARROWEST_S = 0.1
# Least, greatest, sum and count of a bin: the function that adds a value, and the initial value.
STATISTICS = ((np.minimum, np.inf), (np.maximum, -np.inf), (np.add, 0.0), (np.add, 0.0))
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class TrendPoints(NamedTuple):
    """Bins that hold values: middle in s, least, greatest, mean and sum of each."""

    t_s: Floats
    low: Floats
    high: Floats
    mean: Floats
    total: Floats


class Trend:
    """Statistics of values in equal bins of time; the bins double their width when they run out."""

    def __init__(self, width_s: float = NARROWEST_S) -> None:
        """Begin with bins of a width."""
        self.width_s = width_s
        self._bins: list[Floats] = [np.full(BINS, empty) for _, empty in STATISTICS]

    def add(self, t_s: Floats, values: Floats) -> None:
        """Add values at times since the start; NaN and infinite values are ignored."""
        known = np.isfinite(values)
        t_s, values = np.maximum(t_s[known], 0), values[known]
        if not len(values):
            return
        while t_s.max() >= self.width_s * BINS:
            self.width_s *= 2
            self._bins = [
                np.append(join.reduce(bins.reshape(-1, 2), axis=1), np.full(BINS // 2, empty))
                for (join, empty), bins in zip(STATISTICS, self._bins, strict=True)
            ]
        at = (t_s / self.width_s).astype(np.int64)
        new = (values, values, values, np.ones(len(values)))
        for (join, _), bins, added in zip(STATISTICS, self._bins, new, strict=True):
            join.at(bins, at, added)

    def points(self) -> TrendPoints:
        """Return the bins that hold values."""
        held = np.flatnonzero(self._bins[-1])
        low, high, total, count = (bins[held] for bins in self._bins)
        t_s: Floats = np.asarray((held + 0.5) * self.width_s, float)
        return TrendPoints(t_s, low, high, total / count, total)


class AlignedTick(NamedTuple):
    """A tick at full strength; t_s: since the recording's start.

    sensing_now_ns, instant_ns: time of the tick and of the pulse played, on the sensing clock.
    """

    t_s: float
    sensing_now_ns: int
    instant_ns: int
    felt_n: float


class AlignedBlock(NamedTuple):
    """Consecutive ticks; target_n: target force at the finger, NaN where nothing was sensed."""

    t_s: Floats
    target_n: Floats
    felt_n: Floats


class ForceAlignment:
    """Alignment of felt force with the pulse at the wrist, in blocks of ticks.

    No block spans two sessions. take_block: receives each complete block. errors: as the display
    computes them; those of strain are None until `set_playback` gives the strain per newton. ratio:
    target force at the finger per force at the wrist; None before the first status.
    """

    def __init__(self, take_block: Callable[[AlignedBlock], object]) -> None:
        self._take_block = take_block
        self.errors = TrackingError()
        self.channel = 0
        self._begin()

    def _begin(self) -> None:
        self.ratio: float | None = None
        self._ticks: list[AlignedTick] = []
        self._t_ns: list[Ints] = []
        self._values: list[Floats] = []

    def begin(self) -> None:
        """Complete the blocks of a session, and begin another."""
        self.finish()
        self._begin()

    def set_playback(
        self, channel: int, ratio: float, strain_per_newton: float | None = None
    ) -> None:
        """Set channel, ratio and strain by the first status, and score the ticks before it.

        strain_per_newton: of the layer under the finger, in 1/N; None where it is not recorded.
        """
        if self.ratio is not None:
            return
        self.errors.strain_per_newton = strain_per_newton
        self.channel, self.ratio = channel, ratio
        for t_ns, values in zip(self._t_ns, self._values, strict=True):
            self._add_reference(t_ns, values, ratio)
        for tick in self._ticks:
            self.errors.add_output(tick.sensing_now_ns, tick.instant_ns, tick.felt_n)

    def add_frame(self, frame: Frame, description: StreamDescription) -> None:
        """Add a frame's samples."""
        at = np.arange(len(frame.values), dtype=np.int64) * frame.period_ns
        t_ns = frame.t_first_ns - description.group_delay_ns + at
        values = frame.values.astype(np.float64)
        self._t_ns.append(t_ns)
        self._values.append(values)
        if self.ratio is not None:
            self._add_reference(t_ns, values, self.ratio)
        if len(self._t_ns) > MAX_FRAMES:
            del self._t_ns[: MAX_FRAMES // 2], self._values[: MAX_FRAMES // 2]

    def _add_reference(self, t_ns: Ints, values: Floats, ratio: float) -> None:
        target_n = values[:, self.channel] * ratio
        self.errors.add_reference_force(t_ns.tolist(), target_n.tolist())

    def add_tick(self, tick: AlignedTick) -> None:
        """Add a tick."""
        self._ticks.append(tick)
        if self.ratio is not None:
            self.errors.add_output(tick.sensing_now_ns, tick.instant_ns, tick.felt_n)
        if len(self._ticks) >= PATIENCE + BLOCK:
            self._release()

    def finish(self) -> None:
        """Complete the remaining blocks."""
        while self._ticks:
            self._release()
        self.errors.finish()

    def _release(self) -> None:
        ticks, self._ticks = self._ticks[:BLOCK], self._ticks[BLOCK:]
        if self.ratio is None or not self._t_ns:
            return
        t_ns, values = np.concatenate(self._t_ns), np.concatenate(self._values)
        order = np.argsort(t_ns, kind="stable")
        t_ns, values = t_ns[order], values[order]
        instant_ns = np.array([tick.instant_ns for tick in ticks], np.int64)
        target_n = self.ratio * interpolate(instant_ns, t_ns, values[:, self.channel])
        t_s, felt_n = np.array([(tick.t_s, tick.felt_n) for tick in ticks]).T
        self._take_block(AlignedBlock(t_s, target_n, felt_n))
        keep = max(0, int(np.searchsorted(t_ns, instant_ns[-1])) - 1)
        self._t_ns, self._values = [t_ns[keep:]], [values[keep:]]


class ForceHistory:
    """Forces of a recording: errors over time, blocks for two plots, heart rates.

    first, worst: the first blocks at full strength, and those around the largest error. heart:
    time in s, and heart rate per minute at wrist and finger, None for a window with a gap.
    """

    def __init__(self) -> None:
        self.alignment = ForceAlignment(self._take)
        self.error_n, self.jnd_n = Trend(), Trend()
        self.first: list[AlignedBlock] = []
        self.worst: list[AlignedBlock] = []
        self.heart: list[tuple[float, float | None, float | None]] = []
        self._before: list[AlignedBlock] = []
        self._worst_n = -1.0
        self._follow_worst = False
        self._heart_blocks: list[AlignedBlock] = []

    def _take(self, block: AlignedBlock) -> None:
        error_n = block.felt_n - block.target_n
        known_n = block.target_n[~np.isnan(error_n)]
        if not len(known_n):
            return
        self.error_n.add(block.t_s, error_n)
        jnd_n = JND * float(np.ptp(known_n))
        self.jnd_n.add(block.t_s, np.full(len(block.t_s), jnd_n))
        self._keep_for_plots(block, float(np.nanmax(np.abs(error_n))))
        self._add_heart_rates(block)

    def _keep_for_plots(self, block: AlignedBlock, largest_n: float) -> None:
        """Keep the first blocks, and the block with the largest error with those beside it."""
        if len(self.first) < FIRST_BLOCKS:
            self.first.append(block)
        if self._follow_worst:
            self.worst.append(block)
        self._follow_worst = largest_n > self._worst_n
        if self._follow_worst:
            self._worst_n, self.worst = largest_n, [*self._before, block]
        self._before = [block]

    def _add_heart_rates(self, block: AlignedBlock) -> None:
        """Add the heart rates of a window once it is complete."""
        self._heart_blocks.append(AlignedBlock(*(values[::THIN] for values in block)))
        t_s, *forces_n = (np.concatenate(parts) for parts in zip(*self._heart_blocks, strict=True))
        if t_s[-1] - t_s[0] < HEART_WINDOW_S:
            return
        self._heart_blocks.clear()
        wrist, felt = (_heart_rate_per_min(t_s, force_n) for force_n in forces_n)
        self.heart.append((float(t_s.mean()), wrist, felt))


def _heart_rate_per_min(t_s: Floats, force_n: Floats) -> float | None:
    known = ~np.isnan(force_n)
    t_s, force_n = t_s[known], force_n[known]
    if len(t_s) < 2 or np.diff(t_s).max() > MAX_GAP_S:
        return None
    even_s = np.linspace(t_s[0], t_s[-1], len(t_s))
    return heart_rate_per_min(even_s, np.interp(even_s, t_s, force_n))


class ContactorFindings:
    """Forces at wrist and finger over a recording, and the beats.

    name: of the contactor; empty before the display's first status. beats: statistics of them.
    trends: interval in ms, height in mN and quality of each beat over the time of the recording.
    """

    def __init__(self) -> None:
        self.name = ""
        self.forces = ForceHistory()
        self.beats = BeatStatistics()
        self.trends: defaultdict[str, Trend] = defaultdict(Trend)

    def begin(self) -> None:
        """Begin another session."""
        self.forces.alignment.begin()
        self.beats.restart()

    def set_playback(self, playing: dict[str, Any]) -> None:
        """Set channel, scale and strain by the display's status."""
        channel, ratio = int(playing["channel"]), float(playing["force_ratio"])
        strain = playing.get("strain_per_newton")
        self.forces.alignment.set_playback(
            channel, ratio, None if strain is None else float(strain)
        )

    def add_frame(
        self, frame: Frame, description: StreamDescription, last_s: float, last_ns: int
    ) -> None:
        """Add a frame; last_s, last_ns: time of its last sample, in the recording and sensed."""
        alignment = self.forces.alignment
        alignment.add_frame(frame, description)
        for beat in self.beats.observe(frame.samples_of(alignment.channel)):
            t_s = np.array([last_s + (beat.onset_ns - last_ns) * 1e-9])
            values = {
                "interval_ms": beat.interval_s * 1e3,
                "height_mn": beat.height_n * 1e3,
                "quality": math.nan if beat.quality is None else beat.quality,
            }
            for name, value in values.items():
                self.trends[name].add(t_s, np.array([value]))

    def add_tick(
        self, t_s: float, sensing_now_ns: int, instant_ns: int, state: dict[str, Any]
    ) -> None:
        """Add a tick at full strength; state: fields of this contactor."""
        felt_n = float(state.get("felt_n", math.nan))
        self.forces.alignment.add_tick(AlignedTick(t_s, sensing_now_ns, instant_ns, felt_n))
