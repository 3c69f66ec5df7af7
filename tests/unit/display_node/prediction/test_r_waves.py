"""R waves are found in time, whatever the lead's gain, sign, drift and noise."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.prediction.r_waves import RWaveDetector, RWaveTime
from sensing_node.sources.heart import draw_ecg

Floats = NDArray[np.float64]
RNG = np.random.default_rng(1)
SECONDS = 60
# Sinus rhythm with variability.
BEATS_S = np.cumsum(0.8 * (1 + 0.1 * RNG.standard_normal(90)))
BEATS_S = BEATS_S[BEATS_S < SECONDS - 1]


def times_s(rate_hz: float) -> Floats:
    return np.arange(SECONDS * rate_hz) / rate_hz


def ecg(t_s: Floats) -> Floats:
    return draw_ecg(t_s, [(at_s, 1.0) for at_s in BEATS_S.tolist()])


def found(t_s: Floats, values: Floats, frame: int = 5) -> list[RWaveTime]:
    detector, waves = RWaveDetector(), []
    times_ns = np.round(t_s * 1e9).astype(int).tolist()
    for first in range(0, len(values), frame):
        part = slice(first, first + frame)
        waves += detector.observe(times_ns[part], values[part].tolist())
    return waves


def check(waves: list[RWaveTime], within_s: float, from_s: float = 4.0, missed: int = 0) -> None:
    """Check that each beat has its R wave, up to some missed ones, and nothing else is one."""
    at_s = np.array([wave.at_ns * 1e-9 for wave in waves])
    at_s, beats_s = at_s[at_s > from_s], BEATS_S[from_s < BEATS_S]
    nearest_s = np.abs(at_s[:, np.newaxis] - beats_s).min(axis=1)
    assert nearest_s.max() < within_s
    assert len(beats_s) - missed <= len(at_s) <= len(beats_s)


@pytest.mark.parametrize("rate_hz", [125.0, 200.0, 250.0, 360.0, 1000.0])
def test_r_waves_are_found_to_the_millisecond_at_any_rate(rate_hz: float) -> None:
    t_s = times_s(rate_hz)
    check(found(t_s, ecg(t_s)), within_s=0.0035)


@pytest.mark.parametrize("gain", [-1.0, 1e-3, -1e6])
def test_sign_and_gain_do_not_matter(gain: float) -> None:
    t_s = times_s(250.0)
    check(found(t_s, gain * ecg(t_s)), within_s=0.0035)


@pytest.mark.parametrize("factor", [-1.0, 0.1, 10.0])
def test_a_lead_whose_gain_or_sign_changes_is_followed_within_4_s(factor: float) -> None:
    t_s = times_s(250.0)
    values = ecg(t_s) * np.where(t_s < 20, 1.0, factor)
    check(found(t_s[t_s < 20], values[t_s < 20]), within_s=0.0035, missed=60)
    after = [wave for wave in found(t_s, values) if wave.at_ns > 24e9]
    check(after, within_s=0.0035, from_s=24.0)


def test_an_r_wave_is_found_50_ms_after_it() -> None:
    t_s = times_s(1000.0)
    latencies_ns = [wave.found_ns - wave.at_ns for wave in found(t_s, ecg(t_s))[3:]]
    assert max(latencies_ns) < 50_000_000
    assert min(latencies_ns) > 20_000_000


def test_frames_of_any_size_give_the_same_r_waves() -> None:
    t_s = times_s(360.0)
    values = ecg(t_s)
    assert found(t_s, values, frame=1) == found(t_s, values, frame=97)


def test_late_samples_are_passed_over_and_a_gap_or_no_number_begins_anew() -> None:
    t_s = times_s(250.0)
    values = ecg(t_s)
    detector = RWaveDetector()
    times_ns = np.round(t_s * 1e9).astype(int).tolist()
    waves = detector.observe(times_ns[:5_000], values[:5_000].tolist())
    assert detector.observe(times_ns[4_000:4_500], values[4_000:4_500].tolist()) == []
    gap = values.copy()
    gap[5_500] = math.nan
    waves += detector.observe(times_ns[5_250:], gap[5_250:].tolist())
    check(waves, within_s=0.0035, missed=2)


def test_peaks_of_noise_are_not_distinct_as_those_of_an_ecg_are() -> None:
    t_s = times_s(250.0)
    noise = np.random.default_rng(2).standard_normal(len(t_s))
    for values, distinct in ((noise, False), (ecg(t_s) + 0.05 * noise, True)):
        detector = RWaveDetector()
        detector.observe(np.round(t_s * 1e9).astype(int).tolist(), values.tolist())
        assert detector.distinct is distinct
