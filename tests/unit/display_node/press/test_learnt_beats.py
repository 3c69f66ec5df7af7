"""What is learnt of each beat: its height, its place in memory, and respiration."""

import math

import numpy as np
import pytest

from display_node.press.learnt_beats import (
    BeatLevels,
    BeatMemory,
    PulseHeight,
)
from display_node.press.respiration import (
    FEWEST_BEATS,
    FITTED_S,
    LEAST_DOUBT,
    MOST_WAVE,
    REGULAR_S,
    FittedWave,
    fit_wave,
)


def beat(number: int, force_n: float) -> BeatLevels:
    return BeatLevels(0.8 * number, 0.15, force_n, 0.0, (0.0, 0.1, 0.4, 0.6, 1.0))


def test_a_wave_is_expected_in_the_newest_beats_only_and_not_after_a_restart() -> None:
    memory = BeatMemory()
    for number in range(60):
        memory.add(beat(number, 0.05 * (number % 20)))
    wave = FittedWave(1.5, 0.0, 0.0, 0.08, 0.02)
    before = memory.rows[0].copy()
    memory.expect(wave)
    assert memory.rows[0] == before
    np.testing.assert_allclose(memory["expected"][-1], 0.08 * np.sin(1.5 * 0.8 * 59))
    assert memory["respiration"][-1] == memory["expected"][-1]
    memory.restart()
    memory.add(beat(0, 0.5))
    before = memory.rows[:-1].copy()
    memory.expect(wave)
    np.testing.assert_array_equal(memory.rows[:-1], before)


MS = 1_000_000
BEAT_NS = 800 * MS


def pulse(time_s: float) -> float:
    """Return a pulse of height 1 with a second wave."""
    phase_s = time_s % 0.8
    waves = ((0.98, 0.14, 0.045), (0.5, 0.28, 0.055))
    return sum(a * math.exp(-0.5 * ((phase_s - t_s) / w_s) ** 2) for a, t_s, w_s in waves)


def beats(wave_n: float, moving_n: float = 0.0) -> list[BeatLevels]:
    heights, found = PulseHeight(), []
    for number in range(4000):
        time_s = 5e-3 * number
        value_n = pulse(time_s) + wave_n * math.sin(2 * math.pi * 0.25 * time_s)
        beat = heights.add(
            1.0 + moving_n * math.sin(2 * math.pi * time_s), value_n, 5 * MS * number, BEAT_NS
        )
        found += [] if beat is None else [beat]
    return found


def test_each_beat_gives_its_height_also_on_a_respiratory_wave() -> None:
    for wave_n in (0.0, 0.1):
        found = beats(wave_n)
        assert len(found) == pytest.approx(24, abs=1)
        assert all(beat.height_n == pytest.approx(1.0, abs=0.08) for beat in found)
        assert all(abs(beat.levels_n[0]) < wave_n + 0.02 for beat in found)
        assert all(0.08 < beat.rise_s < 0.41 for beat in found)
        middle = [beat.levels_n[2] for beat in found]
        assert max(middle) - min(middle) < 2 * wave_n + 0.02


def test_a_moving_hold_down_gives_no_height() -> None:
    assert not beats(0.0, 0.06)
    assert all(beat.moved_n == pytest.approx(0.03, abs=0.006) for beat in beats(0.0, 0.03))


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


def test_few_beats_and_old_ones_show_none() -> None:
    times_s = NOW_S - 0.8 * np.arange(FEWEST_BEATS - 1)
    assert fit_wave(times_s, np.zeros(len(times_s)), NOW_S) is None
    times_s = NOW_S - 0.8 * np.arange(30)
    assert fit_wave(times_s, np.zeros(30), NOW_S + FITTED_S) is None
    assert fit_wave(np.full(30, -math.inf), np.zeros(30), NOW_S) is None
