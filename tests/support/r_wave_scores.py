"""Score of the R waves that are found in a lead, against its annotated beats."""

from bisect import bisect_right
from typing import NamedTuple

import numpy as np

from display_node.prediction.r_waves import RWaveDetector
from tests.support.drawn_pulses import FRAME, Floats

# ANSI/AAMI EC57: a detection within 150 ms of an annotated beat is that beat. Its learning period
# of five minutes is not used: only the first 5 s do not count.
MATCH_S, MATCHED_FROM_S = 0.15, 5.0


class AnnotatedLead(NamedTuple):
    """A lead of an ECG, and the times of its annotated beats."""

    name: str
    rate_hz: float
    ecg_mv: Floats
    beats_s: Floats

    def __str__(self) -> str:
        return self.name


class DetectorScore(NamedTuple):
    """R waves found of a lead against its annotations: counts, and latency in ms."""

    lead: str
    beats: int
    missed: int
    false: int
    deviation_ms: float
    latency_ms: float

    @property
    def sensitivity(self) -> float:
        """Share of the annotated beats that were found."""
        return 1 - self.missed / self.beats

    @property
    def precision(self) -> float:
        """Share of the R waves found that are annotated beats."""
        found = self.beats - self.missed
        return found / (found + self.false)


def score_lead(lead: AnnotatedLead) -> DetectorScore:
    """Find the R waves of a lead frame by frame, and match them with its annotations."""
    detector, found_s, latencies_s = RWaveDetector(), [], []
    times_ns = np.round(np.arange(len(lead.ecg_mv)) * 1e9 / lead.rate_hz).astype(int).tolist()
    values = lead.ecg_mv.tolist()
    for first in range(0, len(values), FRAME):
        for wave in detector.observe(
            times_ns[first : first + FRAME], values[first : first + FRAME]
        ):
            found_s.append(wave.at_ns * 1e-9)
            latencies_s.append((wave.found_ns - wave.at_ns) * 1e-9)
    beats_s: list[float] = lead.beats_s.tolist()
    pairs = _match(beats_s, found_s)
    scored = range(bisect_right(beats_s, MATCHED_FROM_S), len(beats_s))
    missed = len(set(scored) - {beat for beat, _ in pairs})
    matched = {found for _, found in pairs}
    candidates = range(
        bisect_right(found_s, MATCHED_FROM_S), bisect_right(found_s, beats_s[-1] + MATCH_S)
    )
    errors_s = [found_s[found] - beats_s[beat] for beat, found in pairs if beat in scored]
    return DetectorScore(
        lead.name,
        len(scored),
        missed,
        len(set(candidates) - matched),
        1e3 * float(np.std(errors_s)) if errors_s else np.nan,
        1e3 * float(np.median(latencies_s)),
    )


def _match(beats_s: list[float], found_s: list[float]) -> list[tuple[int, int]]:
    """Return the places of matched beats and R waves; each R wave matches one beat, in order."""
    pairs, position = [], 0
    for beat, beat_s in enumerate(beats_s):
        while position < len(found_s) and found_s[position] < beat_s - MATCH_S:
            position += 1
        if position < len(found_s) and found_s[position] <= beat_s + MATCH_S:
            pairs.append((beat, position))
            position += 1
    return pairs
