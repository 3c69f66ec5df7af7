"""Sensitivity and precision of R waves on drawn leads, whose beats are known.

No package in the test extra has an ECG with annotated beats. Records of PhysioNet are scored by
`make bench ARGS="announce --records FOLDER"`.
"""

import numpy as np
import pytest
from numpy.typing import NDArray

from sensing_node.sources.heart import draw_ecg
from tests.support.r_wave_scores import AnnotatedLead, score_lead

Floats = NDArray[np.float64]
SECONDS, RATE_HZ = 300.0, 360.0
T_S = np.arange(SECONDS * RATE_HZ) / RATE_HZ


def wide_beat(t_s: Floats, at_s: float) -> Floats:
    """Draw a ventricular beat: no P wave, a complex of 0.16 s, and an opposite T wave."""
    waves = ((1.6, 0.0, 0.028), (-0.9, 0.07, 0.028), (-0.45, 0.26, 0.06))
    return np.asarray(
        sum(
            mv * np.exp(-0.5 * ((t_s - at_s - after_s) / width_s) ** 2)
            for mv, after_s, width_s in waves
        )
    )


def lead(seed: int, noise_mv: float, wander_mv: float, ectopics: float) -> AnnotatedLead:
    """Draw a lead with noise, baseline wander and hum; a share of the beats is ventricular."""
    rng = np.random.default_rng(seed)
    intervals_s = 0.8 * (1 + 0.08 * rng.standard_normal(400))
    early = rng.random(400) < ectopics
    early[1:] &= ~early[:-1]
    # An ectopic beat is early, and a pause follows it.
    intervals_s[early] *= 0.65
    intervals_s[1:][early[:-1]] *= 1.35
    beats_s = np.cumsum(intervals_s)
    within = beats_s < SECONDS - 1
    beats_s, early = beats_s[within], early[within]
    ecg_mv = draw_ecg(T_S, [(at_s, 1.0) for at_s in beats_s[~early].tolist()])
    for at_s in beats_s[early].tolist():
        first, last = np.searchsorted(T_S, (at_s - 0.3, at_s + 0.6))
        ecg_mv[first:last] += wide_beat(T_S[first:last], at_s)
    # Beats vary in height as a chest moves.
    ecg_mv *= 1 + 0.15 * np.sin(2 * np.pi * 0.25 * T_S)
    ecg_mv += wander_mv * np.sin(2 * np.pi * 0.3 * T_S) + 0.05 * np.sin(2 * np.pi * 50 * T_S)
    ecg_mv += noise_mv * rng.standard_normal(len(T_S))
    return AnnotatedLead("drawn", RATE_HZ, ecg_mv, beats_s)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("noise_mv", "wander_mv", "ectopics"),
    [(0.02, 0.5, 0.0), (0.1, 1.0, 0.0), (0.02, 0.5, 0.1), (0.1, 1.0, 0.1)],
)
def test_sensitivity_and_precision_are_at_least_99_percent(
    noise_mv: float, wander_mv: float, ectopics: float, seed: int
) -> None:
    score = score_lead(lead(seed, noise_mv, wander_mv, ectopics))
    assert score.beats > 350
    assert score.sensitivity >= 0.99
    assert score.precision >= 0.99
