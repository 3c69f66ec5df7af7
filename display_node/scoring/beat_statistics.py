"""Statistics of a stream's beats for the summary, and the alarm on what is no pulse. Pure."""

import statistics
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from display_node.scoring.beat_quality import GOOD
from display_node.scoring.beats import Beat, BeatAnalysis
from display_node.scoring.rises import LONGEST
from display_node.scoring.step_means import STEP_S
from protocol.summary.fields import BeatFigures
from protocol.wire.messages import ChannelSamples

# Medians are over the good beats of this time.
MINUTE_NS = 60_000_000_000
# Longest time without the end of a beat. The slowest beats last 3 s, and the first one is found
# after 1.25 s.
WITHOUT_NS = 5_000_000_000
# Rates that are counted; the latter with a tolerance.
SLOWEST_PER_MIN, FASTEST_PER_MIN, TOLERATED_PER_MIN = 20, 300, 306
LONGEST_S = LONGEST * STEP_S
# Of this number of beats, as many doubtful ones begin the alarm.
JUDGED, DOUBTFUL = 3, 2


def pulse_alarm(beats: Mapping[str, Any]) -> str | None:
    """Return the text of the pulse alarm of a summary's `beats`; None while it is off."""
    if not beats.get("alarm"):
        return None
    advice = "check the sensor's place and contact"
    quality, rate_per_min = beats.get("quality"), beats.get("rate_per_min")
    if rate_per_min is not None and rate_per_min > TOLERATED_PER_MIN:
        return f"the received pulse is above the {FASTEST_PER_MIN} /min that are counted: {advice}"
    if rate_per_min is not None and rate_per_min < 60 / LONGEST_S:
        return f"the received pulse is below the {SLOWEST_PER_MIN} /min that are counted: {advice}"
    # Statuses of other programs may lack this figure.
    of = "" if quality is None else f" (quality {quality:.2f})"
    return f"the received signal is no regular pulse{of}: {advice}"


class BeatStatistics:
    """Statistics over all sessions of a run.

    Counts are of the run. Rate, quality and medians begin anew after a gap in the stream, and the
    alarm takes no gap for a pause of the pulse.
    """

    def __init__(self) -> None:
        self._count = self._doubtful = 0
        self.restart()

    def restart(self) -> None:
        """Begin with another session, whose clock and pulse may be others."""
        self._analysis = BeatAnalysis()
        self._begin()

    def _begin(self) -> None:
        """Begin with the first sample of a session, or after a gap."""
        self._began_ns = self._ended_ns = self._analysis.began_ns
        self._good: deque[Beat] = deque()
        # Of the newest beats; None for one that cannot be compared yet, which counts as good.
        self._qualities: deque[float | None] = deque(maxlen=JUDGED)
        self._intervals_s: deque[float] = deque(maxlen=JUDGED)
        # Newest sample; `_ended_ns` is the end of the newest beat, at first the first sample.
        self._newest_ns = 0

    def observe(self, samples: ChannelSamples) -> list[Beat]:
        """Take a frame's samples and return new beats, as `BeatAnalysis.observe` does."""
        beats = self._analysis.observe(samples)
        if self._analysis.began_ns != self._began_ns:
            self._begin()
        self._newest_ns = max(self._newest_ns, samples.times_ns[-1])
        for beat in beats:
            self._add(beat)
        return beats

    def _add(self, beat: Beat) -> None:
        self._count += 1
        self._ended_ns = beat.onset_ns + round(beat.interval_s * 1e9)
        self._qualities.append(beat.quality)
        self._intervals_s.append(beat.interval_s)
        if not beat.good:
            self._doubtful += 1
            return
        good = self._good
        good.append(beat)
        while good[0].onset_ns < beat.onset_ns - MINUTE_NS:
            good.popleft()

    def figures(self, force_ratio: float | None = None) -> BeatFigures:
        """Return the figures so far.

        force_ratio: force at the finger per force at the wrist; None where it is not constant.
        """
        if self._ended_ns is None:
            return BeatFigures()
        without = self._newest_ns - self._ended_ns > WITHOUT_NS
        qualities, good = self._qualities, self._good
        doubtful = sum(quality is not None and quality < GOOD for quality in qualities)
        longer_s = [each_s for each_s in self._intervals_s if each_s > LONGEST_S]
        slow = len(longer_s) >= DOUBTFUL
        found = BeatFigures(
            count=self._count,
            rate_per_min=60 / statistics.median(longer_s) if slow else None,
            quality=0.0 if without else qualities[-1] if qualities else None,
            doubtful=self._doubtful / self._count if self._count else None,
            alarm=without or doubtful >= DOUBTFUL,
        )
        if not good or slow:
            return found
        intervals_s = np.array([beat.interval_s for beat in good])
        rate_per_min = 60 / float(np.median(intervals_s))
        notches_ns = [b.notch_ns - b.onset_ns for b in good if b.notch_ns is not None]
        has_notch = 2 * len(notches_ns) > len(good)
        height_n = statistics.median(beat.height_n for beat in good)
        return replace(
            found,
            rate_per_min=rate_per_min,
            variability_ms=float(intervals_s.std()) * 1e3,
            height_n=height_n,
            height_at_finger_n=None if force_ratio is None else force_ratio * height_n,
            upstroke_ms=statistics.median(beat.upstroke_s for beat in good) * 1e3,
            notch_ms=statistics.median(notches_ns) * 1e-6 if has_notch else None,
            alarm=found.alarm or rate_per_min > TOLERATED_PER_MIN,
        )
