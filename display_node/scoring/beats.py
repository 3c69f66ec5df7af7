"""Beats of a pulse, one by one: onset, peak, notch, height, and whether they can be trusted. Pure.

The pulse is averaged over steps of 5 ms (`step_means.py`), in which the beats are found
(`rises.py`). A beat is complete, and reported, when the next one has begun. The work is done in
pieces, one a frame: a display observes the pulse in the thread of its force loop.
"""

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.beat_quality import AFTER, BEFORE, GOOD, BeatShape, ShapeMemory
from display_node.scoring.rises import FEWEST, LONGEST, MOST, RISE, RiseDetector
from display_node.scoring.step_means import STEP_NS, STEP_S, StepMeans
from protocol.wire.messages import ChannelSamples

Floats = NDArray[np.float64]
# Time within which a crossing is followed by its steepest step.
FOLLOWS = 25
# Steps that are kept: the longest beat, and what is needed before and after it.
KEPT = MOST + RISE + BEFORE + AFTER + 2 * FOLLOWS


class Beat(NamedTuple):
    """One beat. Times are on the clock of the samples.

    Attributes
    ----------
    onset_ns : int
        Where the tangent of the steepest rise meets the level of the foot.
    peak_ns : int
        Systolic peak.
    notch_ns : int or None
        Dicrotic notch: the minimum before the last wave of the beat; None without such a wave.
    foot_n, height_n : float
        Force at the foot, and from foot to peak.
    interval_s : float
        Time to the next onset.
    quality : float or None
        0 to 1: similarity to the beats before, 0 for an implausible one or one that is longer than
        3 s. None for the first three, and for the first three after a gap of 0.1 s.
    """

    onset_ns: int
    peak_ns: int
    notch_ns: int | None
    foot_n: float
    height_n: float
    interval_s: float
    quality: float | None

    @property
    def good(self) -> bool:
        """True unless the beat is doubtful; one that cannot be compared yet counts as good."""
        return self.quality is None or self.quality >= GOOD

    @property
    def upstroke_s(self) -> float:
        """Time from onset to peak."""
        return (self.peak_ns - self.onset_ns) * 1e-9


# The peak is searched in this time after the onset, at most in half of the beat.
PEAK_WITHIN = 80
# The notch is searched from this time after the peak on; the wave after it has at least this share
# of the beat's height. A slow respiratory wave rises by up to 1.5 % of it within RISE.
NOTCH_FROM, NOTCH_WITHIN, NOTCH_SHARE = 10, 100, 0.02


class Span(NamedTuple):
    """Onset of a beat and of the following one, in steps counted to the middle of a step."""

    onset: float
    following: float


class BeatAnalysis:
    """Analysis of one channel's samples, frame by frame. It begins anew after a gap of 0.1 s.

    began_ns: time of the first sample, or of the first one after the last gap; None before any.
    """

    def __init__(self) -> None:
        self._begin(0)
        self.began_ns: int | None = None

    def _begin(self, begin_ns: int) -> None:
        """Begin at a time. In a gap the sensor may have moved: earlier shapes are no measure."""
        self.began_ns = begin_ns
        self._shapes = ShapeMemory()
        self._steps = StepMeans(begin_ns)
        self._rises = RiseDetector()
        # Means over the steps from number `_first` on.
        self._means: list[float] = []
        self._first = 0
        # Work to be done: rises whose onset is not found yet, beats that are not measured, and the
        # measured one that is not judged.
        self._crossings: deque[int] = deque()
        self._spans: deque[Span] = deque()
        self._measured: tuple[Beat, BeatShape] | None = None
        self._crossed = 0
        self._onset: float | None = None

    def observe(self, samples: ChannelSamples) -> list[Beat]:
        """Take a frame's samples; return the beats that became complete.

        Frames may be out of order by 0.1 s; later ones are ignored, and repeated ones.
        """
        if self.began_ns is None or not self._steps.follows(samples):
            self._begin(samples.times_ns[0])
        for mean in self._steps.add(samples):
            self._add(mean)
        beats = []
        # One piece, and more for a long frame.
        for _ in range(1 + len(samples.times_ns) * samples.period_ns // (2 * STEP_NS)):
            beat = self._work()
            if beat is not None:
                beats.append(beat)
        return beats

    def _add(self, mean: float) -> None:
        """Add the mean of a step, and note where a beat rises."""
        means = self._means
        means.append(mean)
        if len(means) > 2 * KEPT:
            self._first += len(means) - KEPT
            del means[:-KEPT]
        step = self._first + len(means) - 1
        rise = mean - min(means[-RISE - 1 :])
        if self._rises.begins_beat(step, rise, mean):
            self._crossings.append(step)

    def _work(self) -> Beat | None:
        """Do one piece of work; return the beat that it completes."""
        end = self._first + len(self._means)
        if self._crossings and self._crossings[0] + FOLLOWS < end:
            self._take_onset(self._crossings.popleft())
        elif self._measured is not None:
            beat, shape = self._measured
            self._measured = None
            if beat.interval_s > LONGEST * STEP_S:
                return beat._replace(quality=0.0)
            return beat._replace(quality=self._shapes.judge(shape, round(beat.interval_s / STEP_S)))
        elif self._shapes.learns:
            self._shapes.learn()
        elif self._spans and round(self._spans[0].onset) + AFTER <= end:
            self._measured = self._measure(self._spans.popleft())
        return None

    def _take_onset(self, crossed: int) -> None:
        """Find the onset around a crossing; note the beat that it completes."""
        # Not before the rise of the beat before.
        earliest = max(crossed - 2 * RISE, self._crossed, self._first + 2)
        follows = min(FOLLOWS, (crossed - self._crossed) // 2)
        self._crossed = crossed
        begin = earliest - 2
        means = np.array(self._means[begin - self._first : crossed - self._first + follows])
        at = max(crossed - RISE, earliest) - begin
        at += int(means[at : crossed - begin + 1].argmin())
        slopes = (means[at + 2 :] - means[at - 2 : -4]) / 4
        steepest, slope = at + int(slopes.argmax()), float(slopes.max())
        before = means[max(steepest - RISE, 0) : steepest + 1]
        foot = _mean_around(before, int(before.argmin()))
        rise = _mean_around(means, steepest) - foot
        onset = begin + steepest - (rise / slope if slope > 0 else 0.0)
        last, self._onset = self._onset, onset
        if last is not None and FEWEST <= onset - last <= MOST:
            self._spans.append(Span(last, onset))

    def _measure(self, span: Span) -> tuple[Beat, BeatShape] | None:
        """Return a beat without its quality, and its shape; None if its begin is not kept."""
        onset = round(span.onset)
        begin, steps = onset - RISE, round(span.following - span.onset)
        if begin < self._first:
            return None
        kept = self._means[begin - self._first : onset - self._first + max(steps, AFTER)]
        means = np.array(kept)
        wave = means[RISE : RISE + steps]
        peak = int(wave[: min(PEAK_WITHIN, steps // 2)].argmax())
        beginning = means[: RISE + peak + 1]
        foot_n = _mean_around(beginning, int(beginning.argmin()))
        height_n = float(wave[peak]) - foot_n
        notch = _notch(wave, peak, height_n)
        beat = Beat(
            self._time_ns(span.onset),
            self._time_ns(onset + _vertex(wave, peak)),
            None if notch is None else self._time_ns(onset + notch),
            foot_n,
            height_n,
            (span.following - span.onset) * STEP_S,
            None,
        )
        return beat, BeatShape(means[RISE - BEFORE : RISE + AFTER], height_n)

    def _time_ns(self, step: float) -> int:
        return self._steps.begin_ns + round((step + 0.5) * STEP_NS)


def _mean_around(values: Floats, at: int) -> float:
    return float(values[max(at - 1, 0) : at + 2].mean())


def _vertex(wave: Floats, at: int) -> float:
    """Return the place of the vertex of a parabola through an extreme value and its neighbours."""
    if not 0 < at < len(wave) - 1:
        return float(at)
    before, middle, after = wave[at - 1 : at + 2].tolist()
    bend = before - 2 * middle + after
    return at + 0.5 * (before - after) / bend if bend else float(at)


def _notch(wave: Floats, peak: int, height_n: float) -> float | None:
    """Return the place of the last minimum of a beat that a wave follows."""
    end = min(peak + NOTCH_WITHIN, 3 * len(wave) // 4)
    if end - peak - NOTCH_FROM < 3:
        return None
    # Without the last part, in which the next beat begins to rise.
    until = min(end + RISE, 17 * len(wave) // 20)
    smooth = np.convolve(wave[: until + 2], np.full(5, 0.2), "same")[:until]
    inner = smooth[peak + NOTCH_FROM : end]
    lowest = (inner[1:-1] <= inner[:-2]) & (inner[1:-1] < inner[2:])
    for at in (peak + NOTCH_FROM + 1 + np.flatnonzero(lowest)[::-1]).tolist():
        if smooth[at : at + RISE].max() - smooth[at] > NOTCH_SHARE * height_n:
            return _vertex(smooth, at)
    return None
