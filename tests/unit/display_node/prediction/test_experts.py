import numpy as np
import pytest

from display_node.prediction.analogue import Analogue
from display_node.prediction.expert import History
from display_node.prediction.fir import Fir
from display_node.prediction.harmonic import Harmonic, Rhythm
from tests.support.pulse_signals import BEAT_S, Floats, beats, expert_errors

T_S = np.arange(6_000) * 0.005


def test_fir_learns_a_sum_of_sinusoids() -> None:
    signal = sum((np.sin(2 * np.pi * hz * T_S + hz) for hz in (0.9, 2.3, 6.1)), np.zeros(6_000))
    assert expert_errors(Fir(), signal, from_step=4_000).max() < 5e-3


def test_analogue_continues_a_periodic_beat() -> None:
    assert expert_errors(Analogue(), beats(T_S), from_step=2_000).max() < 0.01


def test_analogue_continues_a_beat_whose_period_is_no_whole_number_of_steps() -> None:
    signal = beats(T_S, intervals_s=(0.8033,))
    assert expert_errors(Analogue(), signal, from_step=3_000).max() < 0.06


def harmonic_with_rhythm(interval: float) -> tuple[Rhythm, Harmonic]:
    rhythm = Rhythm()
    rhythm.interval = interval
    return rhythm, Harmonic(rhythm)


def wave(hertz: Floats) -> Floats:
    """Three harmonics of a frequency that may change."""
    phase = 2 * np.pi * np.cumsum(hertz) * 0.005
    return np.asarray(np.sin(phase) + 0.5 * np.cos(2 * phase) + 0.2 * np.sin(5 * phase) + 0.3)


def test_harmonic_continues_harmonics_from_a_rough_interval() -> None:
    _, expert = harmonic_with_rhythm(interval=1.04 * BEAT_S / 0.005)
    signal = wave(np.full(6_000, 1 / BEAT_S))
    assert expert_errors(expert, signal, from_step=3_000).max() < 0.02
    assert expert.alive


def test_harmonic_follows_a_slow_change_of_frequency() -> None:
    rhythm, expert = harmonic_with_rhythm(interval=200)
    hertz = np.linspace(1.0, 1.5, 6_000)

    def beat(step: int) -> None:
        rhythm.interval = 200 / hertz[step]

    assert expert_errors(expert, wave(hertz), from_step=3_000, before=beat).max() < 0.3


def test_harmonic_is_dropped_when_it_diverges_and_then_holds() -> None:
    _, expert = harmonic_with_rhythm(interval=BEAT_S / 0.005)
    history = History(8_192)
    signal = wave(np.full(2_000, 1 / BEAT_S))
    signal[1_000:] = 3 * np.random.default_rng(1).standard_normal(1_000)
    alive = []
    for value in signal.tolist():
        history.push(value)
        expert.learn(history)
        alive.append(expert.alive)
        if not expert.alive:
            assert not expert.predict(history).any()
    assert all(alive[:1_000])
    assert not all(alive[1_000:])


@pytest.mark.parametrize("ratio", [0.3, 3.0])
def test_harmonic_is_dropped_where_the_rhythm_is_another(ratio: float) -> None:
    rhythm, expert = harmonic_with_rhythm(interval=160)
    history = History(8_192)
    for value in wave(np.full(1_000, 1 / BEAT_S)).tolist():
        history.push(value)
        expert.learn(history)
    assert expert.alive
    rhythm.interval = 160 * ratio
    history.push(0.0)
    expert.learn(history)
    assert not expert.alive


@pytest.mark.parametrize("interval_s", [0.4, 0.8, 1.5])
def test_rhythm_finds_the_interval(interval_s: float) -> None:
    t_s = np.arange(3_000) * 0.005
    rhythm, signal = Rhythm(), beats(t_s, (interval_s,))
    for before, after in zip(signal[:-2].tolist(), signal[2:].tolist(), strict=True):
        rhythm.push(after - before)
    assert rhythm.interval == pytest.approx(interval_s / 0.005, abs=1)


def test_rhythm_knows_no_interval_of_what_has_no_beats() -> None:
    rhythm = Rhythm()
    for _ in range(2_000):
        rhythm.push(0.0)
    assert rhythm.interval is None


def test_history_keeps_the_newest_whatever_has_passed() -> None:
    history, all_values = History(100), np.random.default_rng(1).standard_normal(1_234)
    for value in all_values.tolist():
        history.push(value)
    np.testing.assert_array_equal(history.last(100), all_values[-100:].astype(np.float32))
    history.rewrite(3, 7.0)
    history.rewrite(100, 8.0)
    assert history.last(4)[0] == 7.0
    assert 8.0 not in history.last(100)
