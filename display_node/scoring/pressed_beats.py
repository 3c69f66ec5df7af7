"""Beats of a wrist that is pressed: found at a steady hold-down, measured, and judged. Pure."""

from collections import deque
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.beat_quality import AFTER, BEFORE, BeatShape, similarity
from display_node.scoring.beats import Beat, BeatAnalysis
from display_node.scoring.depth_curve import BeatPoint
from display_node.scoring.step_means import STEP_NS, STEP_S
from protocol.wire.messages import ChannelSamples

Floats = NDArray[np.float64]
# With the hold-down the pulse may fall faster than the search for beats follows. The search begins
# anew after this time without a beat; before its first one it takes longer.
PULSELESS_NS, FIRST_NS = 2_500_000_000, 10_000_000_000
# A beat is flat where it is within this share of its height above the foot.
NEAR_FOOT: Final = 0.1
# A beat is compared with so many before and after it, as far as they are of the same level.
NEIGHBOURS: Final = 4
# A beat is compared over this time after its onset; what follows may be the next one.
COMPARED_S: Final = 0.5
# The hold-down steps where it changes by this share and force within this time; the beats of the
# next level are searched anew.
STEP_SHARE, STEP_N, WITHIN_NS = 0.03, 0.03, 300_000_000
# Over a beat the hold-down may change by this share and force, as in a steady sweep.
STEADY_SHARE, STEADY_N = 0.03, 0.05


class RenewedAnalysis:
    """Analysis of beats that begins anew where none was found for a while."""

    def __init__(self) -> None:
        self._analysis = BeatAnalysis()
        self._until_ns: int | None = None

    def observe(self, pulse: ChannelSamples) -> list[Beat]:
        """Take a frame's samples; return the beats that became complete."""
        now_ns = pulse.times_ns[-1]
        beats = self._analysis.observe(pulse)
        if beats:
            self._until_ns = now_ns + PULSELESS_NS
        elif self._until_ns is None:
            self._until_ns = now_ns + FIRST_NS
        elif now_ns > self._until_ns:
            self._until_ns, self._analysis = now_ns + FIRST_NS, BeatAnalysis()
        return beats


class SteadyAnalysis:
    """Analysis of beats that also begins anew where the hold-down steps."""

    def __init__(self) -> None:
        self._analysis = RenewedAnalysis()
        # Time of each recent frame, and its hold-down.
        self._recent: deque[tuple[int, float]] = deque()

    def observe(self, pulse: ChannelSamples, hold_down_n: float) -> list[Beat]:
        """Take a frame's samples and mean hold-down; return the beats that became complete."""
        first_ns, recent = pulse.times_ns[0], self._recent
        recent.append((first_ns, hold_down_n))
        while first_ns - recent[0][0] > WITHIN_NS:
            recent.popleft()
        if abs(hold_down_n - recent[0][1]) > STEP_SHARE * abs(hold_down_n) + STEP_N:
            self._analysis = RenewedAnalysis()
            return []
        return self._analysis.observe(pulse)


def steady_hold_down_n(hold_downs_n: Floats) -> float | None:
    """Return the mean hold-down over a beat's samples; None where it moved."""
    force_n, edge = float(hold_downs_n.mean()), len(hold_downs_n) // 10 + 1
    moved_n = abs(float(hold_downs_n[-edge:].mean() - hold_downs_n[:edge].mean()))
    return force_n if moved_n <= STEADY_SHARE * force_n + STEADY_N else None


def beat_shape(beat: Beat, times_ns: Floats, forces_n: Floats) -> BeatShape | None:
    """Return a beat's shape in steps around its onset; None where samples are missing."""
    grid_ns = beat.onset_ns + STEP_NS * np.arange(-BEFORE, AFTER + 1.0)
    if len(times_ns) < 2 or not times_ns[0] <= grid_ns[0] <= grid_ns[-1] <= times_ns[-1]:
        return None
    areas = np.concatenate(
        [[0.0], np.cumsum(0.5 * np.diff(times_ns) * (forces_n[1:] + forces_n[:-1]))]
    )
    means = np.diff(np.interp(grid_ns, times_ns, areas)) / STEP_NS
    return BeatShape(means, beat.height_n)


def measure_beat(beat: Beat, times_ns: Floats, forces_n: Floats, hold_down_n: float) -> BeatPoint:
    """Measure a beat's height and shape."""
    interval_ns = beat.interval_s * 1e9
    first, last = np.searchsorted(times_ns, [beat.onset_ns, beat.onset_ns + interval_ns])
    above = (forces_n[first:last] - beat.foot_n) / beat.height_n
    notch_ns = beat.notch_ns
    return BeatPoint(
        hold_down_n,
        beat.height_n,
        float(above.mean()),
        beat.upstroke_s / beat.interval_s,
        float("nan") if notch_ns is None else (notch_ns - beat.onset_ns) / interval_ns,
        float((above < NEAR_FOOT).mean()),
        1.0 if beat.quality is None else beat.quality,
    )


def judge_beat(number: int, points: Sequence[BeatPoint], shapes: Sequence[BeatShape]) -> float:
    """Return a beat's similarity to its neighbours of the same level."""
    before = shapes[max(number - NEIGHBOURS, 0) : number]
    others = [*before, *shapes[number + 1 : number + 1 + NEIGHBOURS]]
    found = similarity(shapes[number], others, round(COMPARED_S / STEP_S))
    return points[number].quality if found is None else found
