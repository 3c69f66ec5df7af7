"""Scores of the predictors on a pulse of which samples are lost."""

import numpy as np
import pytest

from benchmarks.prediction import AHEAD_MS, score
from tests.support.drawn_pulses import SCORED_FROM_S, Pulse

RATE_HZ = 50.0


def test_lost_samples_are_not_given_to_the_predictors() -> None:
    """Hold predicts the newest sample that has arrived: it is wrong by what has come since."""
    t_s = np.arange(round((SCORED_FROM_S + 3) * RATE_HZ)) / RATE_HZ
    true = np.sqrt(2) * np.sin(2 * np.pi * t_s)
    sensed = true.copy()
    sensed[::2] = np.nan
    sensed[-50:-30] = np.nan
    whole, gaps = (score(Pulse("sine", each, true, RATE_HZ, 2)) for each in (true, sensed))
    assert len(gaps["hold"]) == len(AHEAD_MS)
    assert np.isfinite(list(gaps.values())).all()
    assert gaps["hold"] == pytest.approx(whole["hold"], rel=0.1)
