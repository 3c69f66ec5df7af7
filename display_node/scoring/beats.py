"""Beats of a pulse, one by one: onset, peak, notch, height, and whether they can be trusted. Pure.

The pulse is averaged over steps of 5 ms. A beat is found where it rises far, and to a high level,
compared with the last seconds; a second wave within the same beat rises as far at most to half the
level. A beat is complete, and reported, when the next one has begun.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.beat_quality import AFTER, BEFORE, GOOD, BeatShape, ShapeMemory
from protocol.config.arguments import number
from protocol.errors import ArgumentError
from protocol.wire.messages import ChannelSamples, channel_samples

Floats = NDArray[np.float64]
STEP_NS = 5_000_000
STEP_S = STEP_NS * 1e-9
# Work is done in pieces of at least this number of steps, 0.2 s.
PIECE = 40
# Over a longer gap the search begins anew; shorter ones are interpolated.
MAX_GAP_NS = 100_000_000
# Samples are averaged after this time, within which frames may change places.
HELD_NS = 100_000_000
# Steps that are kept, 8 s: three of the longest beats.
KEPT = 1_600
# A beat lasts 0.27 to 2.5 s: 24 to 222 beats a minute.
SHORTEST, LONGEST = 54, 500
# Time within which a rise is measured, and within which a crossing is followed by its steepest
# step.
RISE, FOLLOWS = 50, 25
# Before a rhythm is known, a rise must have this share of the highest ones.
FIRST_SHARE = 0.6
# Afterwards, the share that is required falls between these two parts of a usual interval: until
# then, a rise is more likely a second wave; later, an early beat that may be weak.
EARLY_SHARE, LATE_SHARE = 0.6, 0.33
EARLY, LATE = 0.5, 0.63
INTERVALS = 8


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
        0 to 1: similarity to the beats before, 0 for an implausible one. None for the first three.
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


class RiseDetector:
    """Detector of beats from the rise and level at each step."""

    def __init__(self) -> None:
        # Highest rises of the last windows, of which each contains a beat. The least of them
        # counts: the others may contain artefacts.
        self._highest: deque[float] = deque(maxlen=3)
        self._least_highest, self._window_highest = math.inf, 0.0
        # The first window is shorter.
        self._window_end = LONGEST // 2
        self._intervals: deque[int] = deque(maxlen=INTERVALS)
        self._usual: int | None = None
        self._last: int | None = None
        self._rising = False

    def begins_beat(self, step: int, rise: float, level: float) -> bool:
        """Return whether a beat rises at this step.

        Parameters
        ----------
        step
            Number of the step.
        rise
            Rise of the pulse within the last 250 ms.
        level
            0 at the lowest value of the last seconds, 1 at the highest.
        """
        self._window_highest = max(self._window_highest, rise)
        if step >= self._window_end:
            self._highest.append(self._window_highest)
            self._least_highest = min(self._highest)
            self._window_highest, self._window_end = 0.0, step + LONGEST
        score, least, was_rising = rise * level, self._least_highest, self._rising
        self._rising = score > LATE_SHARE * least and score > self._share(step) * least
        if not self._rising or was_rising:
            return False
        if self._last is not None:
            if step - self._last < SHORTEST:
                return False
            if step - self._last <= LONGEST:
                self._intervals.append(step - self._last)
            else:
                self._intervals.clear()
            # An upper quantile: after second waves were taken for beats, half are too short.
            intervals = sorted(self._intervals)
            self._usual = intervals[-1 - len(intervals) // 4] if len(intervals) > 1 else None
        self._last = step
        return True

    def _share(self, step: int) -> float:
        if self._last is None or self._usual is None:
            return FIRST_SHARE
        passed = ((step - self._last) / self._usual - EARLY) / (LATE - EARLY)
        return EARLY_SHARE + (LATE_SHARE - EARLY_SHARE) * min(max(passed, 0.0), 1.0)


# The peak is searched in this time after the onset, at most in half of the beat.
PEAK_WITHIN = 80
# The notch is searched from this time after the peak on; the wave after it has at least this share
# of the beat's height. A slow respiratory wave rises by up to 1.5 % of it within RISE.
NOTCH_FROM, NOTCH_WITHIN, NOTCH_SHARE = 10, 100, 0.02


class BeatAnalysis:
    """Analysis of one channel's samples, frame by frame."""

    def __init__(self) -> None:
        self._shapes = ShapeMemory()
        self._begin(0)

    def _begin(self, begin_ns: int) -> None:
        """Begin the steps at a time; the shapes are kept."""
        self._rises = RiseDetector()
        # Frames that are not, or not all, averaged yet, in order of time.
        self._frames: list[ChannelSamples] = []
        self._begin_ns = begin_ns
        self._newest_ns: int | None = None
        # Means over steps from number `_first` on; those before `_searched` were searched.
        self._means = np.zeros(0)
        self._first = self._searched = 0
        self._crossed: int | None = None
        # Step of the present beat's onset, counted to the middle of a step.
        self._onset: float | None = None

    def observe(self, samples: ChannelSamples) -> list[Beat]:
        """Take a frame's samples; return the beats that became complete.

        Frames may be out of order by 0.1 s; later ones are ignored, and repeated ones.
        """
        first_ns, newest_ns = samples.times_ns[0], self._newest_ns
        if newest_ns is None or first_ns - newest_ns > MAX_GAP_NS + samples.period_ns:
            self._begin(first_ns)
            newest_ns = first_ns
        done = self._first + len(self._means)
        averaged_ns = self._begin_ns + done * STEP_NS
        frames = self._frames
        place = len(frames)
        while place and first_ns <= frames[place - 1].times_ns[0]:
            place -= 1
        repeated = place < len(frames) and frames[place].times_ns[0] == first_ns
        if first_ns < averaged_ns or repeated:
            return []
        self._newest_ns = max(newest_ns, samples.times_ns[-1])
        frames.insert(place, samples)
        count = (self._newest_ns - HELD_NS - averaged_ns) // STEP_NS
        if count < PIECE:
            return []
        self._average(averaged_ns, count, samples.period_ns)
        return self._search()

    def _average(self, begin_ns: int, count: int, period_ns: int) -> None:
        """Append the means over `count` steps."""
        frames, times_ns, forces_n = self._frames, list[int](), list[float]()
        for frame in frames:
            times_ns += frame.times_ns
            forces_n += frame.forces_n
        times, values = (np.array(times_ns) - begin_ns).astype(float), np.array(forces_n)
        edges = STEP_NS * np.arange(count + 1.0)
        if period_ns > STEP_NS:
            means = np.interp(edges[:-1] + STEP_NS / 2, times, values)
        else:
            areas = np.cumsum(0.5 * (times[1:] - times[:-1]) * (values[1:] + values[:-1]))
            means = np.diff(np.interp(edges, times[1:], areas)) / STEP_NS
        # The frames that the next means need: from the last but one sample before them on.
        needed_ns = begin_ns + int(times[max(int(np.searchsorted(times, edges[-1])) - 2, 0)])
        self._frames = [frame for frame in frames if frame.times_ns[-1] >= needed_ns]
        last = self._first + len(self._means) + count
        self._means = np.concatenate([self._means[-KEPT:], means])
        self._first = last - len(self._means)

    def _search(self) -> list[Beat]:
        """Search the new means for beats."""
        means, first = self._means, self._first
        at = max(self._searched - first - RISE, 0)
        if len(means) - at <= RISE:
            return []
        windows = np.lib.stride_tricks.sliding_window_view(means[at:], RISE + 1)
        newest, recent = windows[:, -1], means[-LONGEST:]
        low, high = recent.min(), recent.max()
        rises = (newest - windows.min(axis=1)).tolist()
        levels = ((newest - low) / (high - low) if high > low else newest - low).tolist()
        beats = []
        self._searched = first + at + RISE
        for rise, level in zip(rises, levels, strict=True):
            step = self._searched
            if self._rises.begins_beat(step, rise, level):
                self._crossed = step
            if self._crossed == step - FOLLOWS:
                beats += self._take_onset(self._crossed - first)
            self._searched += 1
        return beats

    def _take_onset(self, crossed: int) -> list[Beat]:
        """Find the onset around a crossing; return the beat that it completes."""
        means = self._means
        begin = max(crossed - RISE, 2)
        slopes = (
            means[begin + 2 : crossed + FOLLOWS] - means[begin - 2 : crossed + FOLLOWS - 4]
        ) / 4
        steepest = begin + int(slopes.argmax())
        slope = float(slopes.max())
        before = means[max(steepest - RISE, 0) : steepest + 1]
        foot = _mean_around(before, int(before.argmin()))
        onset = self._first + steepest - (_mean_around(means, steepest) - foot) / slope
        last, self._onset = self._onset, onset
        if last is None or not SHORTEST <= onset - last <= LONGEST:
            return []
        beat = self._complete(last, onset)
        return [] if beat is None else [beat]

    def _complete(self, onset: float, following: float) -> Beat | None:
        """Return the beat between two onsets; None if its begin is not kept."""
        at, steps = round(onset) - self._first, round(following - onset)
        if at < BEFORE:
            return None
        wave = self._means[at : at + steps]
        peak = int(wave[: min(PEAK_WITHIN, steps // 2)].argmax())
        beginning = self._means[max(at - RISE, 0) : at + peak + 1]
        foot_n = _mean_around(beginning, int(beginning.argmin()))
        height_n = float(wave[peak]) - foot_n
        notch = _notch(wave, peak, height_n)
        shape = BeatShape(self._means[at - BEFORE : at + AFTER], height_n)
        return Beat(
            self._time_ns(onset),
            self._time_ns(at + self._first + _vertex(wave, peak)),
            None if notch is None else self._time_ns(at + self._first + notch),
            foot_n,
            height_n,
            (following - onset) * STEP_S,
            self._shapes.judge(shape, steps),
        )

    def _time_ns(self, step: float) -> int:
        return self._begin_ns + round((step + 0.5) * STEP_NS)


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
    smooth = np.convolve(wave, np.full(5, 0.2), "same")[: 17 * len(wave) // 20]
    inner = smooth[peak + NOTCH_FROM : end]
    lowest = (inner[1:-1] <= inner[:-2]) & (inner[1:-1] < inner[2:])
    for at in (peak + NOTCH_FROM + 1 + np.flatnonzero(lowest)[::-1]).tolist():
        if smooth[at : at + RISE].max() - smooth[at] > NOTCH_SHARE * height_n:
            return _vertex(smooth, at)
    return None


def find_beats(force_n: Floats, rate_hz: float) -> list[Beat]:
    """Return the beats of a pulse, as a display finds them.

    Parameters
    ----------
    force_n : ndarray of float
        Force or pressure at equal intervals, shape (samples,); NaN where it is unknown. Heights
        have the unit of the values. Light falls with each beat: give its negative.
    rate_hz : float
        Samples a second, 20 to 100 000.

    Returns
    -------
    list of Beat
        Times in ns since the first sample. The search begins anew after a gap of 0.1 s. The first
        and the last beat are not complete, and missing.

    Raises
    ------
    ArgumentError
        If the rate or the array is not as above. It is a ValueError as well.
    """
    rate_hz = number("rate_hz", rate_hz, 20, 100_000)
    try:
        force_n = np.asarray(force_n, np.float64)
    except (ValueError, TypeError) as error:
        raise ArgumentError(f"force_n: must be an array of numbers: {error}") from None
    if force_n.ndim != 1:
        raise ArgumentError(f"force_n: must have one dimension, got the shape {force_n.shape}")
    period_ns, analysis, beats = round(1e9 / rate_hz), BeatAnalysis(), list[Beat]()
    # Held after the last sample, so that it is averaged as well.
    padded = np.concatenate([force_n, np.repeat(force_n[-1:], math.ceil(0.5 * rate_hz))])
    known = np.isfinite(padded)
    # Frames of about 0.1 s: levels are those of the last seconds before a frame's end.
    ends = np.arange(0, len(padded), math.ceil(0.1 * rate_hz))[1:]
    ends = np.union1d(ends, np.flatnonzero(np.diff(known)) + 1)
    for samples in np.split(np.arange(len(padded)), ends):
        if len(samples) and known[samples[0]]:
            first, forces_n = int(samples[0]), padded[samples].tolist()
            beats += analysis.observe(
                channel_samples(first, first * period_ns, period_ns, forces_n)
            )
    return beats
