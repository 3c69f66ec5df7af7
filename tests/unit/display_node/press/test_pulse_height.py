import math

import pytest

from display_node.press.pulse_height import PulseHeight, RespiratoryWave

MS = 1_000_000
BEAT_NS = 800 * MS


def pulse(time_s: float) -> float:
    """Return a pulse of height 1 with a second wave."""
    phase_s = time_s % 0.8
    waves = ((0.98, 0.14, 0.045), (0.5, 0.28, 0.055))
    return sum(a * math.exp(-0.5 * ((phase_s - t_s) / w_s) ** 2) for a, t_s, w_s in waves)


def beats(wave_n: float, moving_n: float = 0.0) -> list[tuple[float, float, float, float]]:
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
        assert all(height == pytest.approx(1.0, abs=0.08) for _, _, height, _ in found)
        assert all(abs(foot) < wave_n + 0.02 for _, foot, _, _ in found)


def test_a_moving_hold_down_gives_no_height() -> None:
    assert not beats(0.0, 0.06)
    assert all(moved == pytest.approx(0.03, abs=0.006) for *_, moved in beats(0.0, 0.03))


@pytest.mark.parametrize("rate_hz", [0.2, 0.25, 0.33])
def test_respiration_is_followed_between_the_peaks(rate_hz: float) -> None:
    wave, errors = RespiratoryWave(), []
    for number in range(12000):
        time_s = 5e-3 * number
        raised = 0.08 * math.sin(2 * math.pi * rate_hz * time_s)
        wave.observe(pulse(time_s) + raised, 5 * MS * number)
        # At the foot, before the next peak is known.
        if time_s > 30 and number % 160 == 10:
            errors.append(abs(wave.now - raised))
    assert sum(errors) / len(errors) < 0.03
