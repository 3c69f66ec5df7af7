"""Quality of a beat: its similarity to the good beats before. Pure."""

import math
import statistics
from collections import deque
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
# Steps of a beat's shape before and after its onset.
BEFORE, AFTER = 8, 112
# A beat is compared with the median of this number of good beats, at least 3.
SHAPES, FEWEST_SHAPES = 8, 3
# Correlation with that median which gives the quality 0 and 1. Good beats are at least half way.
UNLIKE, ALIKE, GOOD = 0.5, 0.95, 0.5
# Heights differ at most by this factor from the median of the good beats.
HEIGHT_RANGE = 3.0
# Steps after the onset that are compared at least, 0.25 s.
LEAST_COMPARED = 50


class BeatShape(NamedTuple):
    """Shape of a beat from `BEFORE` steps before its onset on, shape (n,), and its height."""

    shape: Floats
    height_n: float


class ShapeMemory:
    """The last good beats, with which a new one is compared.

    Beats that differ from them, but not from the three before, are good: the pulse has changed.
    `judge` a beat, then `learn` it: each takes less time than both at once.
    """

    def __init__(self) -> None:
        self._good: deque[BeatShape] = deque(maxlen=SHAPES)
        # Those since the last good one.
        self._bad: deque[BeatShape] = deque(maxlen=FEWEST_SHAPES)
        # Their medians, and the judged beat that is not learnt yet.
        self._usual: BeatShape | None = None
        self._changed: BeatShape | None = None
        self._judged: tuple[BeatShape, bool] | None = None

    @property
    def learns(self) -> bool:
        """True while the judged beat is not learnt."""
        return self._judged is not None

    def judge(self, beat: BeatShape, steps: int) -> float | None:
        """Return the quality of a beat of a number of steps; None at the start."""
        quality = None if self._usual is None else _alike(beat, self._usual, steps)
        good = quality is None or quality >= GOOD
        if not good and self._changed is not None:
            changed = _alike(beat, self._changed, steps)
            if changed >= GOOD:
                self._good = deque(self._bad, maxlen=SHAPES)
                quality, good = changed, True
        self._judged = beat, good
        return quality

    def learn(self) -> None:
        """Learn the judged beat."""
        if self._judged is None:
            return
        (beat, good), self._judged = self._judged, None
        if good:
            self._bad.clear()
            self._good.append(beat)
            self._usual, self._changed = usual_beat(self._good), None
        else:
            self._bad.append(beat)
            self._changed = usual_beat(self._bad)


def usual_beat(beats: Collection[BeatShape]) -> BeatShape | None:
    """Return the median shape and height of beats; None for fewer than 3."""
    if len(beats) < FEWEST_SHAPES:
        return None
    # The middle of the sorted ones: quicker than numpy.median, with the same values.
    ordered = np.sort([beat.shape for beat in beats], axis=0)
    half = len(beats) // 2
    shape = ordered[half] if len(beats) % 2 else 0.5 * (ordered[half - 1] + ordered[half])
    return BeatShape(shape, statistics.median(beat.height_n for beat in beats))


def similarity(beat: BeatShape, others: Collection[BeatShape], steps: int) -> float | None:
    """Return the similarity of a beat to the median of others, 0 to 1; None for fewer than 3.

    steps: the beat's length; what follows it is not compared.
    """
    usual = usual_beat(others)
    return None if usual is None else _alike(beat, usual, steps)


def _alike(beat: BeatShape, usual: BeatShape, steps: int) -> float:
    if not usual.height_n / HEIGHT_RANGE < beat.height_n < usual.height_n * HEIGHT_RANGE:
        return 0.0
    length = BEFORE + max(steps, LEAST_COMPARED)
    shape = usual.shape[:length] - usual.shape[:length].mean()
    own = beat.shape[:length] - beat.shape[:length].mean()
    scale = math.sqrt(float(shape @ shape) * float(own @ own))
    alike = float(shape @ own) / scale if scale else 0.0
    return min(max((alike - UNLIKE) / (ALIKE - UNLIKE), 0.0), 1.0)
