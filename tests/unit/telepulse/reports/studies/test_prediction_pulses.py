import sys

import numpy as np
import pytest

from telepulse.reports.studies.prediction_pulses import (
    NOISE,
    RATE_HZ,
    RECORDED,
    Beats,
    drawn,
    fibrillating,
    make_rhythm,
    pulses,
    recorded_pulses,
    synthetic_pulses,
    through_chain,
    with_ectopics,
)


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def test_there_are_twelve_sets_of_unit_deviation_and_1_percent_noise() -> None:
    sets = pulses(24.0, seed=1)
    assert len({pulse.name for pulse in sets}) == 12
    for pulse in sets:
        assert pulse.true[20 * RATE_HZ :].std() == pytest.approx(1)
        assert (pulse.sensed - pulse.true).std() == pytest.approx(NOISE, rel=0.05)


def test_without_heartpy_there_are_no_recordings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "heartpy", raising=False)
    monkeypatch.setattr("telepulse.reports.studies.prediction_pulses.find_spec", lambda _: None)
    assert recorded_pulses(10.0) == {}
    assert "heartpy" not in sys.modules
    assert len(RECORDED) == 4


def test_variability_is_as_requested_and_the_ramp_doubles_the_rate() -> None:
    beats = make_rhythm(rng(), 200.0, 0.05, lambda _: 75.0)
    assert beats.intervals_s.std() / beats.intervals_s.mean() == pytest.approx(0.05, rel=0.15)
    ramp = make_rhythm(rng(), 60.0, 0.0, lambda t_s: 60 + t_s)
    assert ramp.intervals_s[0] == 1.0
    assert ramp.intervals_s[-1] == pytest.approx(0.48, abs=0.02)


def test_an_ectopic_beat_is_early_weak_and_followed_by_a_pause() -> None:
    plain = make_rhythm(rng(), 60.0, 0.0, lambda _: 60.0)
    beats = with_ectopics(plain, rng(), 10)
    early = np.flatnonzero(beats.intervals_s < 0.9)
    assert len(early) == pytest.approx(len(plain.intervals_s) / 10, abs=1)
    np.testing.assert_allclose(beats.intervals_s[early + 1], 1.4)
    np.testing.assert_allclose(beats.amplitudes[early + 1], 0.6)
    assert (plain.amplitudes == 1).all()


def test_fibrillating_intervals_are_independent() -> None:
    intervals_s = fibrillating(rng(), 500.0).intervals_s
    assert intervals_s.sum() > 500
    assert np.corrcoef(intervals_s[:-1], intervals_s[1:])[0, 1] == pytest.approx(0, abs=0.1)
    assert intervals_s.std() == pytest.approx(0.14, rel=0.1)


def test_a_drawn_pulse_is_the_synthetic_sources() -> None:
    from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource

    scene = SyntheticScene.model_validate({"kind": "synthetic", "preset": "paper"})
    expected = SyntheticSource(scene).take(5_000)[:, 0]
    ours = drawn(make_rhythm(rng(), 5.0, 0.0, lambda _: 75.0), "paper", 5.0, 0.8)
    assert np.corrcoef(ours, expected)[0, 1] == pytest.approx(1, abs=1e-6)


def test_a_shape_predicts_the_next_beat_only_on_request() -> None:
    beats = fibrillating(rng(), 30.0)
    other = Beats(beats.intervals_s.copy(), beats.amplitudes)
    other.intervals_s[20] -= 0.1
    onset_s = beats.intervals_s[:20].sum() - 2 * beats.intervals_s[0]
    until = round((onset_s + other.intervals_s[20] - 0.2) * RATE_HZ)
    predictive_shape, silent = (
        [drawn(each, "wide", 30.0, 0.8, shape)[:until] for each in (beats, other)]
        for shape in (True, False)
    )
    assert not np.allclose(predictive_shape[0], predictive_shape[1], atol=0.01)
    np.testing.assert_allclose(silent[0], silent[1], atol=0.01)


def test_the_chain_is_causal_and_passes_the_band() -> None:
    pulse = synthetic_pulses(6.0, seed=1)["steady"]
    changed = pulse.copy()
    changed[4_000:] += 1.0
    np.testing.assert_array_equal(through_chain(changed)[:4_000], through_chain(pulse)[:4_000])
    t_s = np.arange(20_000) / RATE_HZ
    gains = [
        through_chain(np.sin(2 * np.pi * hertz * t_s))[10_000:].std() * np.sqrt(2)
        for hertz in (0.4, 4.0, 20.0, 40.0)
    ]
    assert gains == pytest.approx([0.707, 0.995, 0.707, 0.06], abs=0.01)
