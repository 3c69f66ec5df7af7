import math

import pytest

from display_node.press.learnt_beats import BeatLevels, PulseHeight

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
