import numpy as np
import pytest

from telepulse.reports.studies.prediction_oracle import (
    best_filter_errors,
    known_rhythms,
    oracle_errors,
)
from telepulse.reports.studies.prediction_pulses import Pulse

HORIZONS_MS = (20, 50, 100, 200)


def test_an_oracle_that_knows_the_next_interval_makes_no_error() -> None:
    rhythm = known_rhythms(40.0, seed=1)["fibrillation"]
    certain = rhythm._replace(expected_s=rhythm.beats.intervals_s, deviation_s=0.0)
    assert max(oracle_errors(certain, 40.0, 3.0, HORIZONS_MS)) < 0.01


@pytest.mark.parametrize("name", ["variability", "fibrillation"])
def test_an_oracle_that_sees_a_beat_later_and_further_ahead_makes_larger_errors(name: str) -> None:
    rhythm = known_rhythms(40.0, seed=1)[name]
    early, late = (oracle_errors(rhythm, 40.0, widths, HORIZONS_MS) for widths in (3.0, 2.0))
    assert sorted(early) == list(early)
    assert all(one < other for one, other in zip(early, late, strict=True))


def test_the_known_part_of_an_interval_leaves_a_rest_of_the_stated_deviation() -> None:
    for rhythm in known_rhythms(300.0, seed=1).values():
        rest_s = rhythm.beats.intervals_s - rhythm.expected_s
        assert rest_s.std() == pytest.approx(rhythm.deviation_s, rel=0.15)
        assert np.corrcoef(rest_s[:-1], rest_s[1:])[0, 1] == pytest.approx(0, abs=0.15)


def test_the_best_filter_predicts_a_sine_and_the_mean_of_noise() -> None:
    sine = np.sqrt(2) * np.sin(2 * np.pi * np.arange(60_000) / 1_000)
    assert max(best_filter_errors(Pulse("sine", sine, sine), HORIZONS_MS)) < 0.02
    noise = np.random.default_rng(1).standard_normal(60_000)
    errors = best_filter_errors(Pulse("noise", noise, noise), HORIZONS_MS)
    assert errors == pytest.approx([1.0] * len(HORIZONS_MS), abs=0.05)
