import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import signal

from protocol.config.scene import validate
from protocol.errors import SceneError
from sensing_node.sources.synthetic import PRESETS, SyntheticScene
from tests.support.streams import synthetic

RESTLESS: dict[str, Any] = {
    "heart_rate_variability": "10 %",
    "respiration": "20 %",
    "ectopic": "10 %",
    "noise": "1 mN",
    "hum": "5 mN",
}
LONGEST = 20_000
RESTLESS_PULSE = synthetic(**RESTLESS).take(LONGEST)


THREE: list[dict[str, str]] = [
    {"name": "cun", "distance": "5 cm", "peak_to_peak": "0.2 N", "preset": "paper"},
    {"name": "guan", "distance": "2.5 cm", "preload": "0.5 N"},
    {"name": "chi"},
]
RESTLESS_POSITIONS = synthetic(**RESTLESS, position=THREE).take(2 * LONGEST)


def pulse(seconds: float, rate_hz: int = 1000, **keys: object) -> NDArray[np.float64]:
    taken = synthetic(rate=f"{rate_hz} Hz", **keys).take(round(seconds * rate_hz))
    return taken.ravel()


def beat_peaks(force_n: NDArray[np.float64], height: float) -> NDArray[np.intp]:
    """Return the indices of the peaks above a share of the peak-to-peak force."""
    limit_n = force_n.min() + height * np.ptp(force_n)
    peaks: NDArray[np.intp] = signal.find_peaks(force_n, height=limit_n)[0]
    return peaks


def test_a_seed_determines_the_pulse() -> None:
    for keys in (RESTLESS, {"noise": "1 mN"}):
        first, same, other = (pulse(2, seed=seed, **keys) for seed in (1, 1, 2))
        assert np.array_equal(first, same)
        assert not np.array_equal(first, other)


@pytest.mark.parametrize("variability", [0.05, 0.15])
def test_beat_intervals_have_the_scenes_mean_and_deviation(variability: float) -> None:
    force_n = pulse(1800, preset="paper", heart_rate_variability=variability)
    intervals_s = np.diff(beat_peaks(force_n, 0.85)) / 1000
    assert intervals_s.std() / intervals_s.mean() == pytest.approx(variability, rel=0.06)
    assert 1 / intervals_s.mean() == pytest.approx(1.25, rel=0.005)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(("peak_to_peak_n", "preload_n"), [(0.3, 0.3), (2.0, 0.0), (0.1, 1.0)])
@pytest.mark.parametrize("per_minute", [20, 75, 180])
def test_height_mean_and_heart_rate_are_those_of_the_scene(
    preset: str, peak_to_peak_n: float, preload_n: float, per_minute: int
) -> None:
    force_n = pulse(
        60,
        preset=preset,
        peak_to_peak=f"{peak_to_peak_n} N",
        preload=f"{preload_n} N",
        heart_rate=f"{per_minute} /min",
    )
    assert np.ptp(force_n) == pytest.approx(peak_to_peak_n, rel=1e-3)
    assert force_n.mean() == pytest.approx(preload_n, abs=1e-4 * peak_to_peak_n)
    assert len(beat_peaks(force_n, 0.85)) == per_minute


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("per_minute", [18, 75, 240])
def test_the_pulse_is_an_endless_sum_of_beats(preset: str, per_minute: int) -> None:
    force_n = pulse(20, preset=preset, heart_rate=f"{per_minute} /min", preload="1 N")
    t_s = np.arange(len(force_n)) / 1000
    beat_s = 60 / per_minute
    stretch = math.sqrt(beat_s / 0.8)
    beats = np.zeros(len(t_s))
    for wave in PRESETS[preset]:
        for beat in range(-20, math.ceil(20 / beat_s) + 3):
            z = (t_s - beat * beat_s - wave.centre_s * stretch) / (wave.width_s * stretch)
            beats += wave.amplitude * np.exp(-0.5 * z**2)
    # Scale and offset, which another test checks, are fitted.
    slope, offset = np.polyfit(beats, force_n, 1)
    np.testing.assert_allclose(force_n, slope * beats + offset, atol=1e-8)


@pytest.mark.parametrize("preset", PRESETS)
def test_uneven_beats_are_joined_without_a_step(preset: str) -> None:
    keys = RESTLESS | {"noise": "0 N", "hum": "0 N", "preset": preset, "heart_rate": "120 /min"}
    coarse_n, fine_n = pulse(60, 1000, **keys), pulse(60, 10_000, **keys)
    np.testing.assert_allclose(fine_n[::10], coarse_n, atol=1e-8)
    # At ten times the rate, the steps of a smooth curve are a tenth; a jump stays the same.
    assert np.abs(np.diff(fine_n)).max() < 0.11 * np.abs(np.diff(coarse_n)).max()


@pytest.mark.parametrize("share", [0.05, 0.2, 0.5])
def test_premature_beats_have_the_scenes_share_and_a_pause_follows(share: float) -> None:
    force_n = pulse(2400, 200, preset="wide", ectopic=share)
    peaks = beat_peaks(force_n, 0.555)
    heights = (force_n[peaks] - force_n.min()) / np.ptp(force_n)
    intervals_s = np.diff(peaks) / 200
    premature = np.flatnonzero(heights[1:-1] < 0.8) + 1
    assert len(premature) / len(peaks) == pytest.approx(share, abs=0.012)
    assert intervals_s[premature - 1].max() < 0.65 * 0.8
    assert intervals_s[premature].min() > 1.25 * 0.8
    others = np.setdiff1d(np.arange(len(intervals_s) - 1), [*premature, *(premature - 1)])
    assert all(abs(intervals_s[others] - 0.8) < 0.05)


@pytest.mark.parametrize("rate_hz", [0.2, 0.25])
def test_respiration_is_a_sine_of_the_scenes_rate_and_size(rate_hz: float) -> None:
    still_n = pulse(60)
    breath_n = pulse(60, respiration="30 %", respiration_rate=f"{rate_hz} Hz") - still_n
    spectrum = np.abs(np.fft.rfft(breath_n)) ** 2
    assert np.fft.rfftfreq(len(breath_n), 1e-3)[spectrum.argmax()] == pytest.approx(rate_hz)
    assert spectrum.max() > 0.999 * spectrum.sum()
    assert breath_n.std() == pytest.approx(0.3 * still_n.std(), rel=1e-3)


def test_noise_is_white_with_the_scenes_rms() -> None:
    noise_n = pulse(60, noise="2 mN") - pulse(60)
    assert noise_n.std() == pytest.approx(2e-3, rel=0.02)
    assert abs(noise_n.mean()) < 5e-5
    assert abs(np.corrcoef(noise_n[1:], noise_n[:-1])[0, 1]) < 0.02


@pytest.mark.parametrize("rate_hz", [50, 60])
def test_hum_is_an_added_sine_of_the_scenes_rate_and_size(rate_hz: int) -> None:
    quiet = RESTLESS | {"hum": "0 N"}
    hum_n = pulse(10, **quiet | {"hum": "20 mN", "hum_rate": f"{rate_hz} Hz"}) - pulse(10, **quiet)
    t_s = np.arange(len(hum_n)) / 1000
    np.testing.assert_allclose(hum_n, 0.02 * np.sin(2 * np.pi * rate_hz * t_s), atol=1e-12)


NOISELESS = RESTLESS | {"noise": "0 N", "hum": "0 N"}


@pytest.mark.parametrize(("distance", "fraction"), [("8 mm", 10), ("4 mm", 5), ("0.8 mm", 1)])
def test_a_position_has_the_pulse_of_an_earlier_time_exactly(distance: str, fraction: int) -> None:
    # At 8 m/s, 0.8 mm are a tenth of a sample.
    places = [{"name": "first"}, {"name": "second", "distance": distance}]
    force_n = synthetic(**NOISELESS, position=places).take(20_000)
    fine_n = pulse(20, 10_000, **NOISELESS)
    np.testing.assert_allclose(force_n[:, 0], fine_n[::10], atol=1e-8)
    np.testing.assert_allclose(force_n[1:, 1], fine_n[10 - fraction :: 10][: 20_000 - 1], atol=1e-8)


def test_all_positions_have_one_heart_and_noise_of_their_own() -> None:
    places = [{"name": name} for name in ("first", "second", "third")]
    force_n = synthetic(**RESTLESS, position=places).take(LONGEST)
    # Further positions change nothing in the first.
    np.testing.assert_array_equal(force_n[:, :1], RESTLESS_PULSE)
    noise_n = force_n[:, 1:] - force_n[:, :1]
    # The difference of two independent noises of 1 mN; everything else is common.
    assert noise_n.std(axis=0) == pytest.approx([2**0.5 * 1e-3] * 2, rel=0.03)
    assert np.corrcoef(noise_n.T)[0, 1] == pytest.approx(0.5, abs=0.03)


@given(st.lists(st.integers(0, LONGEST // 5), min_size=1, max_size=10))
def test_chunk_sizes_do_not_change_the_samples_of_positions(counts: list[int]) -> None:
    source = synthetic(**RESTLESS, position=THREE)
    together = np.concatenate([source.take(count) for count in counts])
    assert together.shape == (sum(counts), 3)
    np.testing.assert_array_equal(together, RESTLESS_POSITIONS[: len(together)])


def test_the_beats_and_delays_say_when_the_pulse_begins_in_each_channel() -> None:
    source = synthetic(preset="paper", ectopic="20 %", heart_rate_variability="5 %", position=THREE)
    force_n = source.take(30_000)
    centre_s = PRESETS["paper"][0].centre_s
    for delay_s, column_n in zip(source.delays_s, force_n.T, strict=True):
        found_s = beat_peaks(column_n, 0.3) / 1000
        expected_s = [b.onset_s + delay_s + centre_s * b.stretch for b in source.beats]
        within = [at_s for at_s in expected_s if 0 < at_s < 29.9]
        assert len(within) >= 35
        # The next wave moves a peak by less than a sample.
        assert all(np.abs(found_s - at_s).min() <= 1.5e-3 for at_s in within)


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"position": [{"name": "cun"}, {"name": "cun"}]}, "two positions have the name 'cun'"),
        ({"position": [{"name": "announce"}]}, "no position may have the name 'announce'"),
        ({"position": [{"name": "cun", "distance": "1 m"}]}, "position.0.distance"),
        ({"position": [{"name": str(n)} for n in range(17)]}, "position"),
        ({"pulse_wave_velocity": "8 m/s"}, "needs [[sensing.source.position]] tables"),
    ],
)
def test_positions_that_cannot_be_are_refused(keys: dict[str, Any], reason: str) -> None:
    with pytest.raises(SceneError) as refused:
        validate({"kind": "synthetic"} | keys, SyntheticScene, "[sensing.source]")
    assert reason in str(refused.value)
    assert "\n" not in str(refused.value)
