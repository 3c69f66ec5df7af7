"""Quality of a beat: its similarity to the good beats before. Pure."""

import statistics
from collections import deque
from collections.abc import Sequence
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
    """

    def __init__(self) -> None:
        self._good: deque[BeatShape] = deque(maxlen=SHAPES)
        # Those since the last good one.
        self._bad: deque[BeatShape] = deque(maxlen=FEWEST_SHAPES)

    def judge(self, beat: BeatShape, steps: int) -> float | None:
        """Return the quality of a beat of a number of steps, and learn it; None at the start."""
        quality = similarity(beat, self._good, steps)
        if quality is not None and quality < GOOD:
            changed = similarity(beat, self._bad, steps)
            if len(beat.shape) == BEFORE + AFTER:
                self._bad.append(beat)
            if changed is None or changed < GOOD:
                return quality
            quality = changed
            self._good = deque(self._bad, maxlen=SHAPES)
        elif len(beat.shape) == BEFORE + AFTER:
            self._good.append(beat)
        self._bad.clear()
        return quality


def similarity(beat: BeatShape, others: Sequence[BeatShape], steps: int) -> float | None:
    """Return the similarity of a beat to the median of others, 0 to 1; None for fewer than 3.

    steps: the beat's length; what follows it is not compared.
    """
    if len(others) < FEWEST_SHAPES:
        return None
    usual_n = statistics.median(other.height_n for other in others)
    if not usual_n / HEIGHT_RANGE < beat.height_n < usual_n * HEIGHT_RANGE:
        return 0.0
    length = min(len(beat.shape), BEFORE + max(steps, LEAST_COMPARED))
    usual = np.median([other.shape[:length] for other in others], axis=0)
    usual -= usual.mean()
    own = beat.shape[:length] - beat.shape[:length].mean()
    scale = float(np.sqrt((usual @ usual) * (own @ own)))
    alike = float(usual @ own) / scale if scale else 0.0
    return min(max((alike - UNLIKE) / (ALIKE - UNLIKE), 0.0), 1.0)
