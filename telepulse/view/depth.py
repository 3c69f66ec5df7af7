"""Beats of a pressed wrist by its hold-down, as the page shows them of a press or sweep. Pure."""

from bisect import insort
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from display_node.scoring.beat_quality import GOOD, BeatShape
from display_node.scoring.beats import Beat
from display_node.scoring.depth_curve import BeatPoint, DepthCurve, fit_depth_curve
from display_node.scoring.pressed_beats import (
    NEIGHBOURS,
    SteadyAnalysis,
    beat_shape,
    judge_beat,
    measure_beat,
    steady_hold_down_n,
)
from protocol.errors import DepthError
from protocol.wire.messages import channel_samples
from telepulse.view.tables import FAST_ROWS, Floats, RollingTable, Times

# Beats that are kept; a fit to so many takes 0.15 s, so it is repeated after some beats only.
MOST_BEATS, FIT_BEATS = 150, 3
# A beat's shape begins before its onset.
BEFORE_NS = 1_000_000_000
LEVELS = ("light", "deeper", "deepest")


class PressedBeat(NamedTuple):
    """A beat at a hold-down force; number: of beats before it."""

    number: int
    point: BeatPoint
    shape: BeatShape


class DepthState:
    """Hold-down of one wrist, its beats in the order of hold-down, and the curve of their heights.

    pressed: whether the stream has a hold-down. samples: hold-down and pulse of each. analysis:
    finds the beats of a session.
    """

    def __init__(self) -> None:
        self.pressed = False
        self.samples = RollingTable(2, FAST_ROWS)
        self._beats: list[PressedBeat] = []
        self._count = self._fitted = 0
        self._curve: DepthCurve | None = None
        self.analysis = SteadyAnalysis()

    def add_frame(
        self, t_ns: Times, first_ns: int, period_ns: int, pulse_n: Floats, hold_down_n: Floats
    ) -> None:
        """Add a frame's samples, at Unix times; copies are skipped.

        first_ns: time of its first sample on the sensing clock.
        """
        self.pressed = True
        if self.samples.has(int(t_ns[0]), period_ns // 2):
            return
        self.samples.insert(t_ns, np.column_stack([hold_down_n, pulse_n]))
        pulse = channel_samples(0, first_ns, period_ns, pulse_n.tolist())
        for beat in self.analysis.observe(pulse, float(hold_down_n.mean())):
            self._add(beat, int(t_ns[0]) - first_ns)

    @property
    def points(self) -> list[BeatPoint]:
        """The beats, in the order of hold-down."""
        return [beat.point for beat in self._beats]

    @property
    def curve(self) -> DepthCurve | None:
        """The curve of the beats, if there are enough."""
        if self._count - self._fitted >= FIT_BEATS:
            self._fitted = self._count
            try:
                self._curve = fit_depth_curve(self.points)
            except DepthError:
                self._curve = None
        return self._curve

    def _add(self, beat: Beat, unix_ns: int) -> None:
        """Add a beat if it is whole and its hold-down was steady, and judge its neighbours anew.

        unix_ns: Unix time when the sensing clock is 0.
        """
        begin_ns = beat.onset_ns
        rows = self.samples.since(begin_ns + unix_ns - BEFORE_NS)
        # Times from the onset on, which floats hold exactly.
        times_ns = (rows.t_ns - unix_ns - begin_ns).astype(np.float64)
        held_n, pulse_n = rows.values.T
        beat = beat._replace(
            onset_ns=0,
            peak_ns=beat.peak_ns - begin_ns,
            notch_ns=None if beat.notch_ns is None else beat.notch_ns - begin_ns,
        )
        first, last = np.searchsorted(times_ns, [0.0, beat.interval_s * 1e9])
        shape = beat_shape(beat, times_ns, pulse_n)
        force_n = steady_hold_down_n(held_n[first:last]) if first < last else None
        if shape is None or force_n is None:
            return
        point = measure_beat(beat, times_ns, pulse_n, force_n)
        self._count += 1
        added = PressedBeat(self._count, point, shape)
        insort(self._beats, added, key=attrgetter("point.hold_down_n"))
        at = self._beats.index(added)
        points, shapes = self.points, [each.shape for each in self._beats]
        for number in range(max(at - NEIGHBOURS, 0), min(at + NEIGHBOURS + 1, len(points))):
            quality = judge_beat(number, points, shapes)
            judged = points[number]._replace(quality=quality)
            self._beats[number] = self._beats[number]._replace(point=judged)
        if len(self._beats) > MOST_BEATS:
            self._beats.remove(min(self._beats, key=attrgetter("number")))


def levels(curve: DepthCurve) -> dict[str, float | None]:
    """Return the hold-down of the three levels; None where the curve does not show one yet."""
    found = {name: None if at is None else at.value for name, at in curve.levels().items()}
    return found | {"deeper": None} if curve.at_end else found


def depth_columns(depth: DepthState) -> dict[str, tuple[Floats, Floats]]:
    """Return the curves over the hold-down, each as forces in N and values."""
    points = np.array([point[:7] for point in depth.points]).reshape(-1, 7)
    force_n, height_n, mean, upstroke, _, flat, quality = points.T
    good = quality >= GOOD
    curve, newest_n = depth.curve, depth.samples.since(0).values[-1:, 0]
    top_n = float(height_n[good].max(initial=0.0))
    columns = {
        "depth_beats": (force_n[good], height_n[good] * 1e3),
        "depth_doubtful": (force_n[~good], height_n[~good] * 1e3),
        "depth_now": _mark(newest_n, top_n),
        "shape_mean": (force_n[good], mean[good] * 100),
        "shape_upstroke": (force_n[good], upstroke[good] * 100),
        "shape_flat": (force_n[good], flat[good] * 100),
    }
    nothing = np.empty(0)
    if curve is None:
        return columns | dict.fromkeys(("depth_curve", *LEVELS), (nothing, nothing))
    columns["depth_curve"] = curve.force_n[::4], curve.height_n[::4] * 1e3
    for name, level_n in levels(curve).items():
        at_n = np.array([] if level_n is None else [level_n])
        columns[name] = _mark(at_n, float(np.interp(at_n, curve.force_n, curve.height_n).sum()))
    return columns


def _mark(at_n: Floats, height_n: float) -> tuple[Floats, Floats]:
    """Return a vertical line at a force, from 0 to a height; empty without a force."""
    return np.repeat(at_n, 2), np.array([0.0, height_n * 1e3])[: 2 * len(at_n)]
