"""A sweep: hold-down forces one after the other, or rising steadily, and the beats at each. Pure.

The sweep takes the place of a finger: it gives the force that is pressed, and takes what comes back
from the wrist. Its time is that of the samples, so a link's delay does not matter.
"""

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from display_node.scoring.beat_quality import GOOD, BeatShape
from display_node.scoring.beats import Beat
from display_node.scoring.depth_curve import LEVEL_SHARE, BeatPoint, DepthCurve, fit_depth_curve
from display_node.scoring.pressed_beats import (
    NEIGHBOURS,
    RenewedAnalysis,
    beat_shape,
    judge_beat,
    measure_beat,
)
from protocol.errors import DepthError
from protocol.wire.messages import ChannelSamples

# The hold-down has arrived when it stays within this share and force of the level for SETTLED_NS.
# Elsewhere it is measured after UNSETTLED_NS, in which set-points arrive over a slow link too. A
# probe that presses less than TOUCHING of the level has not touched the wrist yet.
NEAR_SHARE, NEAR_N, SETTLED_NS, UNSETTLED_NS = 0.02, 0.01, 300_000_000, 6_000_000_000
TOUCHING: Final = 0.2
# A probe that presses less than this share of a level presses no further.
REACHED: Final = 0.9
# Beyond the largest height, a pulse below this share of it is not pressed further.
CLOSED: Final = 0.3
# Levels around the coarse best one, in steps.
FINE: Final = (-0.5, -0.25, 0.0, 0.25, 0.5)
# Levels between two coarse ones, of which one is above and one below the share of the light and the
# deepest level, in steps.
BETWEEN: Final = (1 / 3, 2 / 3)
# A steady sweep is shown in so many parts.
PARTS: Final = 12
# Beyond the largest height, where the curve is steepest, a steady sweep rises more slowly: once so
# many beats have fallen below this share of it.
FALLING_BEATS, FALLEN, SLOWER = 3, 0.85, 0.3
# The wrist is released for this time at the end.
RELEASE_NS: Final = 1_000_000_000
# Samples that are kept, and the longest wait for samples, which begins with the sweep.
KEPT_NS: Final = 12_000_000_000
WITHOUT_NS: Final = 20_000_000_000


@dataclass(frozen=True, slots=True)
class SweepPlan:
    """Settings of a sweep.

    Attributes
    ----------
    low_n, high_n
        Least and greatest hold-down force.
    steps
        Number of levels from the least to the greatest.
    ramp_ns
        Time in which the force rises steadily instead; None for steps.
    beats, at_most_ns
        A level ends after this number of good beats, or after this time.
    """

    low_n: float = 0.2
    high_n: float = 2.5
    steps: int = 8
    ramp_ns: int | None = None
    beats: int = 5
    at_most_ns: int = 9_000_000_000


class SweptLevel(NamedTuple):
    """The beats of one level, or of one part of a steady sweep; medians are of the good ones."""

    wanted_n: float
    hold_down_n: float
    points: Sequence[BeatPoint]

    @property
    def good(self) -> list[BeatPoint]:
        """The beats of good quality."""
        return [point for point in self.points if point.quality >= GOOD]

    @property
    def height_n(self) -> float:
        """Median height; 0 with fewer than two good beats, which are no pulse."""
        good = self.good
        return statistics.median(point.height_n for point in good) if len(good) > 1 else 0.0


class DepthSweep:
    """A sweep in progress.

    Parameters
    ----------
    plan
        Its settings.
    watch
        Called with each level that is complete.

    Attributes
    ----------
    press_n
        The force to press with now.
    levels
        Complete levels, in the order in which they were pressed.
    notes
        Remarks for the report.
    fault
        Reason why the sweep has ended early, or "".
    over
        True once the sweep has ended and the wrist was released.
    """

    def __init__(self, plan: SweepPlan, watch: Callable[[SweptLevel], None] | None = None) -> None:
        self._plan, self._watch = plan, watch
        self.levels: list[SweptLevel] = []
        self.notes: list[str] = []
        self.fault = ""
        self.over = False
        steps = 1 if plan.ramp_ns is not None else plan.steps
        self._coarse = np.linspace(plan.low_n, plan.high_n, max(steps, 2)).tolist()[:steps]
        self._wanted = self._coarse.pop(0)
        self._fine: list[float] | None = None
        self.press_n = self._wanted
        self._releasing_ns: int | None = None
        self._waited_ns: int | None = None
        self._newest_ns = 0
        self._hold_down_n = 0.0
        # Times at which the level was set, and at which the hold-down had settled.
        self._begin_ns: int | None = None
        self._settled_ns: int | None = None
        # Frames since then: first time, samples, and sum of the hold-down.
        self._samples: list[tuple[int, ChannelSamples, float]] = []
        # Beats and their shapes; the first `_reported` ones are reported already.
        self._points: list[BeatPoint] = []
        self._shapes: list[BeatShape] = []
        self._analysis = RenewedAnalysis()
        self._near_ns = self._reported = 0

    def curve(self) -> DepthCurve:
        """Fit the curve to all beats so far. Raises DepthError."""
        return fit_depth_curve([point for level in self.levels for point in level.points])

    def release(self, fault: str = "") -> None:
        """End the sweep early: ease off. A fault is the reason, for example of the probe."""
        self.fault = self.fault or fault
        self.press_n = 0.0
        if not self._newest_ns:
            # Nothing was pressed yet.
            self.over = True
        if self._releasing_ns is None:
            self._releasing_ns = self._newest_ns

    def restart(self) -> None:
        """End the sweep where the stream begins anew, with times unrelated to those before."""
        if self._newest_ns:
            self._newest_ns = 0
            self._releasing_ns = None
            self.release("the stream began anew during the sweep")

    def tick(self, now_ns: int, probe: str | None) -> None:
        """Take the time of any clock, and the probe's state as it was last reported."""
        if self._waited_ns is None:
            self._waited_ns = now_ns
        waited_ns = now_ns - self._waited_ns
        if waited_ns > WITHOUT_NS:
            self.release("no samples of a pulse and a hold-down have come for 20 s")
        if self._releasing_ns is not None and waited_ns > RELEASE_NS:
            self.over = True
        if probe == "fault":
            self.release("the probe at the wrist reports a fault")
        elif probe == "held":
            self.release("another display presses this wrist")

    def observe(self, pulse: ChannelSamples, hold_downs_n: Sequence[float]) -> None:
        """Take a frame's samples of the film, and the hold-down force of each."""
        self._waited_ns = None
        first_ns, now_ns = pulse.times_ns[0], pulse.times_ns[-1]
        # With a frame that was overtaken no time passes.
        now_ns = max(now_ns, self._newest_ns)
        elapsed_ns, self._newest_ns = now_ns - self._newest_ns, now_ns
        if self._releasing_ns is not None:
            self._releasing_ns = self._releasing_ns or now_ns
            self.over = self.over or now_ns - self._releasing_ns >= RELEASE_NS
            return
        self._hold_down_n = hold_down_n = sum(hold_downs_n) / len(hold_downs_n)
        if self._begin_ns is None:
            self._begin_ns = self._near_ns = now_ns
        if self._settled_ns is None:
            self._settle(hold_down_n, now_ns)
            return
        if first_ns < self._settled_ns:
            return
        self._samples.append((first_ns, pulse, sum(hold_downs_n)))
        beats = self._analysis.observe(pulse)
        if beats:
            self._add(beats)
        if self._plan.ramp_ns is None:
            good = sum(point.quality >= GOOD for point in self._points)
            if good >= self._plan.beats or now_ns - self._settled_ns > self._plan.at_most_ns:
                self._end_level()
        else:
            self._rise(self._plan.ramp_ns, elapsed_ns)

    def _begin_level(self) -> None:
        self._begin_ns = self._settled_ns = None
        self._analysis = RenewedAnalysis()
        self._samples, self._points, self._shapes = [], [], []
        self._near_ns = self._reported = 0

    def _settle(self, hold_down_n: float, now_ns: int) -> None:
        """Begin to measure once the hold-down is at the level, or does not get there."""
        assert self._begin_ns is not None
        if abs(hold_down_n - self._wanted) > NEAR_SHARE * self._wanted + NEAR_N:
            self._near_ns = now_ns
        near, waited_ns = now_ns - self._near_ns >= SETTLED_NS, now_ns - self._begin_ns
        if hold_down_n < TOUCHING * self._wanted:
            if waited_ns > WITHOUT_NS:
                self.release(f"the probe does not press: {self._wanted:.2f} N are set for 20 s")
        elif near or waited_ns >= UNSETTLED_NS:
            self._settled_ns = now_ns

    def _add(self, beats: list[Beat]) -> None:
        """Add beats, and judge all of this level by their similarity to each other."""
        times_ns = np.array([t for _, pulse, _ in self._samples for t in pulse.times_ns])
        forces_n = np.array([n for _, pulse, _ in self._samples for n in pulse.forces_n])
        order = np.argsort(times_ns, kind="stable")
        times_ns, forces_n = times_ns[order], forces_n[order]
        for beat in beats:
            shape = beat_shape(beat, times_ns, forces_n)
            # Beats at the edge of what is kept are not whole.
            if shape is not None:
                self._shapes.append(shape)
                self._points.append(
                    measure_beat(beat, times_ns, forces_n, self._around_peak_n(beat))
                )
        points, shapes = self._points, self._shapes
        for number in range(max(len(points) - len(beats) - NEIGHBOURS, 0), len(points)):
            points[number] = points[number]._replace(quality=judge_beat(number, points, shapes))
        if self._plan.ramp_ns is not None:
            oldest_ns = self._newest_ns - KEPT_NS
            self._samples = [frame for frame in self._samples if frame[0] > oldest_ns]

    def _around_peak_n(self, beat: Beat) -> float:
        """Return the mean hold-down force around a beat's peak, where its height is decided."""
        end_ns = 2 * beat.peak_ns - beat.onset_ns
        frames = [each for each in self._samples if beat.onset_ns <= each[0] < end_ns]
        count = sum(len(pulse.forces_n) for _, pulse, _ in frames)
        return sum(sum_n for *_, sum_n in frames) / count if count else self.press_n

    def _end_level(self) -> None:
        """Report the level, and choose the next one."""
        level = self._report(self._wanted)
        highest_n = max(each.height_n for each in self.levels)
        closed = highest_n > 0 and level.height_n < CLOSED * highest_n
        # Lighter levels than that of the highest pulse are always pressed.
        beyond = closed and level.wanted_n > self._highest().wanted_n
        short = level.hold_down_n < REACHED * level.wanted_n
        if short:
            self._note_limit(level)
        if self._fine is None and (beyond or short or not self._coarse):
            self._fine = self._choose_fine()
        following = self._coarse if self._fine is None else self._fine
        if not following:
            self.release()
            return
        self._wanted = self.press_n = following.pop(0)
        self._begin_level()

    def _report(self, wanted_n: float) -> SweptLevel:
        points = tuple(self._points[self._reported :])
        self._reported = len(self._points)
        hold_downs = [point.hold_down_n for point in points] or [self._hold_down_n]
        level = SweptLevel(wanted_n, statistics.fmean(hold_downs), points)
        self.levels.append(level)
        if self._watch is not None:
            self._watch(level)
        return level

    def _note_limit(self, level: SweptLevel) -> None:
        self.notes.append(
            f"the probe pressed with {level.hold_down_n:.2f} N when {level.wanted_n:.2f} N were"
            " set: its limit, or the travel of its drive"
        )

    def _highest(self) -> SweptLevel:
        return max(self.levels, key=lambda level: level.height_n)

    def _choose_fine(self) -> list[float]:
        """Return further levels: around the best of the coarse ones, and around the other two."""
        plan = self._plan
        try:
            best_n = self.curve().best_n.value
        except DepthError:
            return []
        step_n = (plan.high_n - plan.low_n) / (plan.steps - 1)
        levels_n = [best_n + part * step_n for part in FINE]
        share_n = LEVEL_SHARE * self._highest().height_n
        for before, after in pairwise(self.levels):
            if (before.height_n < share_n) is not (after.height_n < share_n):
                levels_n += [before.wanted_n + part * step_n for part in BETWEEN]
        return [level_n for level_n in sorted(levels_n) if plan.low_n <= level_n <= plan.high_n]

    def _stays(self, part_n: float) -> bool:
        """Return whether the hold-down of the last part is short of it, and has stopped rising.

        part_n: rise of the force from part to part. One that is only late rises as fast.
        """
        last = self.levels[-1]
        if len(self.levels) < 2 or last.hold_down_n >= REACHED * last.wanted_n:
            return False
        return last.hold_down_n - self.levels[-2].hold_down_n < 0.5 * part_n

    def _rise(self, ramp_ns: int, elapsed_ns: int) -> None:
        """Raise the force of a steady sweep, and report a part when it is complete."""
        plan = self._plan
        heights_n = [point.height_n for point in self._points if point.quality >= GOOD]
        falls = bool(heights_n) and (
            statistics.median(heights_n[-FALLING_BEATS:]) < FALLEN * max(heights_n)
        )
        rate = (plan.high_n - plan.low_n) / ramp_ns * (SLOWER if falls else 1.0)
        self.press_n = min(self.press_n + rate * elapsed_ns, plan.high_n)
        passed = (self.press_n - plan.low_n) / (plan.high_n - plan.low_n)
        done = len(self.levels)
        if passed * PARTS >= done + 1:
            self._report(plan.low_n + (plan.high_n - plan.low_n) * (done + 0.5) / PARTS)
            # One part without beats may be one in which they were not found.
            highest, last = self._highest(), self.levels[-1]
            parts = self.levels[-1:] if len(last.good) >= FALLING_BEATS else self.levels[-2:]
            if all(
                level.hold_down_n > highest.hold_down_n
                and level.height_n < CLOSED * highest.height_n
                for level in parts
            ):
                self.release()
            if self._stays((plan.high_n - plan.low_n) / PARTS):
                self._note_limit(last)
                self.release()
        if passed >= 1.0:
            self.release()
