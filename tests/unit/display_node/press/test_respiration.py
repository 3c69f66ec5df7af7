import math

import numpy as np
import pytest

from display_node.press.respiration import (
    FEWEST_BEATS,
    FITTED_S,
    LEAST_DOUBT,
    MOST_WAVE,
    REGULAR_S,
    fit_wave,
)

NOW_S = 3600.0


@pytest.mark.parametrize("rad_per_s", [1.0, 1.51, 2.2])
def test_the_wave_of_the_newest_beats_is_found(rad_per_s: float) -> None:
    random = np.random.default_rng(1)
    times_s = NOW_S - np.cumsum(0.8 + 0.05 * random.standard_normal(30))
    pressures = 0.08 * np.sin(rad_per_s * times_s)
    wave = fit_wave(times_s, pressures + 0.01 * random.standard_normal(30) + 0.05, NOW_S)
    assert wave is not None
    assert wave.rad_per_s == pytest.approx(rad_per_s, abs=0.06)
    assert wave.deviation == LEAST_DOUBT
    newest = times_s > NOW_S - 15
    assert np.abs(wave.at(times_s[newest]) - pressures[newest]).max() < 0.03
    # The next beats, after a round trip and while the hold-down moves.
    for ahead_s in (0.0, 1.0, 2.0):
        expected = 0.08 * math.sin(rad_per_s * (NOW_S + ahead_s))
        assert wave.ahead(NOW_S + ahead_s) == pytest.approx(expected, abs=0.03)


def test_a_wave_is_expected_less_the_longer_it_was_not_seen() -> None:
    times_s = NOW_S - 0.8 * np.arange(30)
    wave = fit_wave(times_s, 0.3 * np.sin(1.5 * times_s), NOW_S)
    assert wave is not None
    soon = [abs(wave.ahead(NOW_S + 0.1 * step)) for step in range(40)]
    late = [abs(wave.ahead(NOW_S + 4 * REGULAR_S + 0.1 * step)) for step in range(40)]
    assert max(soon) == MOST_WAVE > 10 * max(late)


def test_noise_gives_a_small_wave_that_is_uncertain() -> None:
    random = np.random.default_rng(1)
    times_s = NOW_S - 0.8 * np.arange(30)
    wave = fit_wave(times_s, 0.06 * random.standard_normal(30), NOW_S)
    assert wave is not None
    assert wave.deviation > 2 * LEAST_DOUBT


def test_few_beats_and_old_ones_show_none() -> None:
    times_s = NOW_S - 0.8 * np.arange(FEWEST_BEATS - 1)
    assert fit_wave(times_s, np.zeros(len(times_s)), NOW_S) is None
    times_s = NOW_S - 0.8 * np.arange(30)
    assert fit_wave(times_s, np.zeros(30), NOW_S + FITTED_S) is None
    assert fit_wave(np.full(30, -math.inf), np.zeros(30), NOW_S) is None
