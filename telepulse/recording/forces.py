"""Forces and beats of a contactor over a recording, computed from its columns. Pure."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.beat_statistics import BeatStatistics
from display_node.scoring.heart_rate import heart_rate_per_min
from display_node.scoring.tracking_error import Floats, TrackingError
from protocol.wire.telemetry import PlaybackStatus
from telepulse.columns import SessionColumns

Mask = NDArray[np.bool_]
# Ticks of this time are plotted together. Three such blocks are longer than `HEART_WINDOW_S`.
BLOCK_S = 2.048
# Heart rates use every tenth tick, which gives enough points in a beat.
THIN = 10
HEART_WINDOW_S = 6.0
# A window with a longer gap has no heart rate.
MAX_GAP_S = 0.25
# Blocks that are plotted from the start.
FIRST_BLOCKS = 3
# Most bins of a trend, and their least width.
BINS = 1_000
NARROWEST_S = 0.1


class Trend(NamedTuple):
    """Statistics of values in equal bins of time, of those bins that hold values.

    t_s: middle of each bin. low, high, mean, total: least, greatest, mean and sum of its values.
    """

    t_s: Floats
    low: Floats
    high: Floats
    mean: Floats
    total: Floats
    width_s: float


def find_trend(t_s: Floats, values: Floats, width_s: float = NARROWEST_S) -> Trend:
    """Return the trend of values at times since the start; NaN and infinite values are ignored.

    width_s: of the bins, which is doubled until they are enough.
    """
    known = np.isfinite(values)
    t_s, values = np.maximum(t_s[known], 0), values[known]
    while t_s.max(initial=0) >= width_s * BINS:
        width_s *= 2
    at = (t_s / width_s).astype(np.int64)
    low, high = np.full(BINS, np.inf), np.full(BINS, -np.inf)
    np.minimum.at(low, at, values)
    np.maximum.at(high, at, values)
    counts = np.bincount(at, minlength=BINS)
    held = np.flatnonzero(counts)
    total = np.bincount(at, values, BINS).astype(np.float64)[held]
    middle_s = np.asarray((held + 0.5) * width_s, float)
    return Trend(middle_s, low[held], high[held], total / counts[held], total, width_s)


class AlignedBlock(NamedTuple):
    """Consecutive ticks.

    pulse_n: of the played instant, NaN where nothing was sensed. jnd_n: just noticeable difference,
    by which each tick was judged.
    """

    t_s: Floats
    pulse_n: Floats
    felt_n: Floats
    jnd_n: Floats


class ContactorFindings:
    """Findings about a contactor.

    Attributes
    ----------
    name, channel
        Its name, and the channel that it played first.
    ratio : float or None
        Force at the finger per force at the wrist; None where no status states it.
    errors : TrackingError
        Errors as the display computes them.
    error_n, jnd_n : Trend
        Felt force minus pulse, and the just noticeable difference, at full strength.
    first, worst : list of AlignedBlock
        The first blocks at full strength, and those around the largest error.
    heart : list of (float, float or None, float or None)
        Time in s, and heart rate per minute at wrist and finger, None for a window with a gap.
    beats : BeatStatistics
        Statistics of the beats at the wrist.
    trends : dict of str to Trend
        Interval in ms, height in mN and quality of each beat; empty without beats.
    """

    def __init__(self, name: str, sessions: Sequence[SessionColumns], begin_ns: int) -> None:
        """Compute the findings; begin_ns: Unix time at which the recording begins."""
        self.name = name
        played = [(each, each.playing.get(name)) for each in sessions if len(each.frames)]
        known = [(session, playing) for session, playing in played if playing is not None]
        self.channel = known[0][1].channel if known else 0
        self.ratio = known[0][1].force_ratio if known else None
        compared: list[tuple[Floats, Floats, Floats]] = []
        self.errors = TrackingError(
            take_compared=lambda pulse_n, felt_n, jnd_n: compared.append(
                (pulse_n, felt_n, np.full(len(felt_n), jnd_n))
            )
        )
        blocks: list[AlignedBlock] = []
        for session, playing in known:
            self.errors.strain_per_newton = playing.strain_per_newton
            full = session.ticks["full"] & session.ticks["ready"]
            _judge(self.errors, session, playing, full)
            t_s = (session.ticks["unix_ns"][full] - begin_ns) * 1e-9
            blocks += _split(t_s, *np.concatenate([np.empty((3, 0)), *compared], axis=1))
            compared.clear()
        self.heart = list(_heart_rates(blocks))
        errors_n = [block.felt_n - block.pulse_n for block in blocks]
        t_s = np.concatenate([[], *(block.t_s for block in blocks)])
        self.error_n = find_trend(t_s, np.concatenate([[], *errors_n]))
        self.jnd_n = find_trend(t_s, np.concatenate([[], *(block.jnd_n for block in blocks)]))
        largest_n = [float(np.nanmax(np.abs(error_n))) for error_n in errors_n]
        worst = int(np.argmax(largest_n)) if blocks else 0
        self.first, self.worst = blocks[:FIRST_BLOCKS], blocks[max(0, worst - 1) : worst + 2]
        self.beats = BeatStatistics()
        # Without any status, the first channel is analysed.
        beats = [
            row
            for session, playing in (known or played)
            for row in _beats(self.beats, session, playing.channel if playing else 0, begin_ns)
        ]
        columns = np.array(beats).reshape(-1, 4).T
        names = ("interval_ms", "height_mn", "quality")
        self.trends = {
            each: find_trend(columns[0], values)
            for each, values in zip(names, columns[1:], strict=True)
            if beats
        }


def _judge(
    errors: TrackingError, session: SessionColumns, playing: PlaybackStatus, full: Mask
) -> None:
    """Judge what a contactor felt in the ticks at full strength, in the order of arrival.

    Each frame is added after the ticks before its arrival, as in the display: the pulse is bounded,
    and has to hold what is still to be judged.
    """
    errors.begin_session(playing.film_age_ns)
    now_ns, sensing_ns, instant_ns = (
        session.ticks[name][full] for name in ("now_ns", "sensing_ns", "instant_ns")
    )
    felt_n = session.forces_n(playing.contactor)[1][full]
    t_ns = session.pulse_ns()
    pulse_n = playing.force_ratio * session.values[:, playing.channel].astype(np.float64)
    ends = np.cumsum(session.frames["samples"])
    # Number of these ticks before each frame, and after the last one. Those before the first frame
    # are added after it.
    before = np.append(0, np.cumsum(full))[[0, *session.frames["ticks"][1:], len(full)]]
    for frame, (end, count) in enumerate(zip(ends, session.frames["samples"], strict=True)):
        samples, ticks = slice(end - count, end), slice(before[frame], before[frame + 1])
        errors.add_pulse(t_ns[samples].tolist(), pulse_n[samples].tolist())
        errors.add_output(now_ns[ticks], sensing_ns[ticks], instant_ns[ticks], felt_n[ticks])
    errors.finish()


def _split(t_s: Floats, pulse_n: Floats, felt_n: Floats, jnd_n: Floats) -> Iterator[AlignedBlock]:
    """Yield ticks in blocks, without those of which nothing is known."""
    ends = np.flatnonzero(np.diff((t_s - t_s[:1]) // BLOCK_S)) + 1
    for ticks in np.split(np.arange(len(t_s)), ends):
        block = AlignedBlock(t_s[ticks], pulse_n[ticks], felt_n[ticks], jnd_n[ticks])
        if not np.isnan(block.felt_n - block.pulse_n).all():
            yield block


def _heart_rates(
    blocks: Sequence[AlignedBlock],
) -> Iterator[tuple[float, float | None, float | None]]:
    """Yield time, and heart rate at wrist and finger, of windows of whole blocks."""
    window: list[AlignedBlock] = []
    for block in blocks:
        window.append(AlignedBlock(*(values[::THIN] for values in block)))
        t_s, pulse_n, felt_n, _ = map(np.concatenate, zip(*window, strict=True))
        if t_s[-1] - t_s[0] >= HEART_WINDOW_S:
            window.clear()
            wrist, felt = (_heart_rate_per_min(t_s, force_n) for force_n in (pulse_n, felt_n))
            yield float(t_s.mean()), wrist, felt


def _heart_rate_per_min(t_s: Floats, force_n: Floats) -> float | None:
    known = ~np.isnan(force_n)
    t_s, force_n = t_s[known], force_n[known]
    if len(t_s) < 2 or np.diff(t_s).max() > MAX_GAP_S:
        return None
    even_s = np.linspace(t_s[0], t_s[-1], len(t_s))
    return heart_rate_per_min(even_s, np.interp(even_s, t_s, force_n))


def _beats(
    statistics: BeatStatistics, session: SessionColumns, channel: int, begin_ns: int
) -> Iterator[tuple[float, float, float, float]]:
    """Yield time in s, interval in ms, height in mN and quality of each beat of a session."""
    statistics.restart()
    ahead_ns = session.frames["unix_ahead_ns"].tolist()
    for frame, unix_ahead_ns in zip(session.each_frame(), ahead_ns, strict=True):
        for beat in statistics.observe(frame.samples_of(channel)):
            quality = math.nan if beat.quality is None else beat.quality
            t_s = (beat.onset_ns + unix_ahead_ns - begin_ns) * 1e-9
            yield t_s, beat.interval_s * 1e3, beat.height_n * 1e3, quality
