"""Each pulse of people has the statistics that it stands for, measured from the pulse itself."""

from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from scipy.signal import butter, find_peaks, sosfiltfilt

from tests.support.drawn_pulses import SCORED_FROM_S, Floats, Pulse
from tests.support.people_pulses import PEOPLE, people_pulses

SECONDS = 300.0
MEASURED_HZ = 500
REGULAR = [
    name
    for name, (rhythm, _, sensor) in PEOPLE.items()
    if not (rhythm.ectopic or rhythm.fibrillation_hz or rhythm.falls_bpm or sensor.movement)
]
FIBRILLATING = [name for name, person in PEOPLE.items() if person.rhythm.fibrillation_hz]
LOW_HZ, RESPIRATORY_HZ = (0.04, 0.15), (0.15, 0.4)


class Measured(NamedTuple):
    """Beats of a pulse: intervals in s from each to the next, heights, and feet."""

    intervals_s: Floats
    heights: Floats
    feet: Floats


@cache
def pulses() -> dict[str, Pulse]:
    return {pulse.name: pulse for pulse in people_pulses(SECONDS, 3)}


@cache
def measure(name: str) -> Measured:
    """Find the steepest rises of a pulse without noise, and what is around them."""
    pulse = pulses()[name]
    given_s = np.arange(len(pulse.true)) / pulse.rate_hz
    values = np.interp(np.arange(0, given_s[-1], 1 / MEASURED_HZ), given_s, pulse.true)
    band = butter(2, min(8.0, 0.4 * pulse.rate_hz), fs=MEASURED_HZ, output="sos")
    slope = np.gradient(sosfiltfilt(band, values))
    least = 0.35 * np.percentile(slope, 98)
    rises, _ = find_peaks(slope, height=least, distance=round(0.28 * MEASURED_HZ))
    within = [values[first:last] for first, last in pairwise(rises)]
    before = [values[max(rise - 100, 0) : rise + 1].min() for rise in rises]
    tops = np.array([each[:150].max() for each in within])
    feet = np.array(before[: len(tops)])
    return Measured(np.diff(rises) / MEASURED_HZ, tops - feet, feet)


def share(intervals_s: Floats, values: Floats, band_hz: tuple[float, float]) -> float:
    """Return the share of the variance within a band, of values at each beat."""
    onsets_s = np.concatenate([[0.0], np.cumsum(intervals_s)[:-1]])
    values = np.interp(np.arange(0, onsets_s[-1], 0.25), onsets_s, values)
    powers = np.abs(np.fft.rfft(values - values.mean())) ** 2
    frequencies_hz = np.fft.rfftfreq(len(values), 0.25)
    within = (frequencies_hz >= band_hz[0]) & (frequencies_hz < band_hz[1])
    return float(powers[within].sum() / powers.sum())


def height(name: str) -> float:
    """Return the mean height of a beat, in the units of the pulse."""
    return float(measure(name).heights.mean())


def test_at_least_twelve_pulses_are_drawn_with_rates_of_25_to_250_hz() -> None:
    rates_hz = {pulses()[name].rate_hz for name in PEOPLE}
    assert len(PEOPLE) >= 12
    assert min(rates_hz) == 25
    assert max(rates_hz) == 250


@pytest.mark.parametrize("name", PEOPLE)
def test_a_pulse_has_the_length_rate_and_unit_that_it_states(name: str) -> None:
    pulse = pulses()[name]
    assert name.endswith(f"{pulse.rate_hz:g} Hz")
    assert len(pulse.sensed) == len(pulse.true) == round(SECONDS * pulse.rate_hz)
    assert pulse.frame == 1 or pulse.frame / pulse.rate_hz <= 0.01
    scored = pulse.true[round(SCORED_FROM_S * pulse.rate_hz) :]
    assert (scored.mean(), scored.std()) == pytest.approx((0, 1), abs=1e-9)


@pytest.mark.parametrize("name", REGULAR)
def test_the_intervals_between_beats_vary_as_stated(name: str) -> None:
    rhythm, intervals_s = PEOPLE[name].rhythm, measure(name).intervals_s
    assert 0.020 <= rhythm.sdnn_s <= 0.100
    assert intervals_s.std() == pytest.approx(rhythm.sdnn_s, rel=0.12)
    assert 60 / intervals_s.mean() == pytest.approx(rhythm.bpm, rel=0.02)


@pytest.mark.parametrize("name", REGULAR)
def test_the_variance_of_intervals_has_the_low_frequency_and_respiratory_shares_stated(
    name: str,
) -> None:
    rhythm, intervals_s = PEOPLE[name].rhythm, measure(name).intervals_s
    low, respiratory = rhythm.shares
    if rhythm.breaths_hz < RESPIRATORY_HZ[0]:
        low, respiratory = low + respiratory, 0.0
    assert share(intervals_s, intervals_s, LOW_HZ) == pytest.approx(low, abs=0.07)
    assert share(intervals_s, intervals_s, RESPIRATORY_HZ) == pytest.approx(respiratory, abs=0.11)


@pytest.mark.parametrize("name", REGULAR)
def test_the_height_of_beats_varies_by_5_to_20_percent_with_breathing(name: str) -> None:
    """The range of a wave over a period is on the average 2.5 of its deviations."""
    breaths_hz, found = PEOPLE[name].rhythm.breaths_hz, measure(name)
    within = share(found.intervals_s, found.heights, (breaths_hz - 0.04, breaths_hz + 0.04))
    ranges = 2.5 * within**0.5 * found.heights.std() / found.heights.mean()
    assert 0.05 <= ranges <= 0.20
    if name == "ventilated, 125 Hz":
        assert ranges == pytest.approx(0.17, abs=0.02)


@pytest.mark.parametrize("name", PEOPLE)
def test_the_sensors_noise_has_the_share_of_the_height_stated(name: str) -> None:
    pulse, sensor = pulses()[name], PEOPLE[name].sensor
    assert 0.001 <= sensor.noise <= 0.02
    steps = 1 / sensor.steps if sensor.steps else 0.0
    expected = (sensor.noise**2 + steps**2 / 12) ** 0.5
    assert np.nanstd(pulse.sensed - pulse.true) / height(name) == pytest.approx(expected, rel=0.05)


def test_a_coarse_converter_gives_few_values() -> None:
    sensed = pulses()["coarse steps, 75 Hz"].sensed
    steps = np.diff(np.unique(np.round(sensed, 9)))
    assert steps.min() * 20 == pytest.approx(height("coarse steps, 75 Hz"), rel=0.1)
    assert steps == pytest.approx(steps.min())


def test_samples_are_lost_in_gaps_of_one_pulse_alone() -> None:
    lost = {name: np.isnan(pulse.sensed) for name, pulse in pulses().items()}
    assert [name for name, each in lost.items() if each.any()] == ["gaps, 100 Hz"]
    edges = np.flatnonzero(np.diff(np.pad(lost["gaps, 100 Hz"].astype(int), 1)))
    lengths_s = np.diff(edges)[::2] / 100
    assert len(lengths_s) == SECONDS / 10
    assert 0.09 <= lengths_s.min() < 0.2 < 0.4 < lengths_s.max() <= 0.51
    assert np.isfinite(pulses()["gaps, 100 Hz"].true).all()


def test_one_beat_in_twelve_is_early_and_weak_with_a_full_pause_after_it() -> None:
    found = measure("ectopic, 125 Hz")
    intervals_s, normal_s = found.intervals_s[:-1], float(np.median(found.intervals_s))
    early = np.flatnonzero(intervals_s < 0.78 * normal_s)
    assert len(early) / len(intervals_s) == pytest.approx(1 / 12, rel=0.1)
    pairs_s = intervals_s[early] + found.intervals_s[early + 1]
    assert pairs_s == pytest.approx(2 * normal_s, rel=0.2)
    assert pairs_s.mean() == pytest.approx(2 * normal_s, rel=0.03)
    weak = found.heights[early + 1] / np.median(found.heights)
    assert 0.2 < weak.mean() < 0.7


def test_every_third_beat_of_a_trigeminy_is_early() -> None:
    intervals_s = measure("trigeminy, 100 Hz").intervals_s
    early = np.flatnonzero(intervals_s < 0.78 * np.median(intervals_s))
    assert set(np.diff(early)) == {3}


@pytest.mark.parametrize("name", FIBRILLATING)
def test_intervals_in_fibrillation_have_a_long_tail_and_a_variation_of_0_24(name: str) -> None:
    intervals_s = measure(name).intervals_s
    away = (intervals_s - intervals_s.mean()) / intervals_s.std()
    assert intervals_s.std() / intervals_s.mean() == pytest.approx(0.24, abs=0.03)
    assert (away**3).mean() > 0.4


@pytest.mark.parametrize("name", FIBRILLATING[:1])
def test_a_beats_height_follows_from_the_interval_before_and_not_from_its_own(name: str) -> None:
    """What the height says of the beat's own interval, the interval before has said."""
    found = measure(name)
    before_s, own_s, heights = found.intervals_s[:-1], found.intervals_s[1:], found.heights[1:]
    assert np.corrcoef(heights, before_s)[0, 1] > 0.8
    explained = np.polyval(np.polyfit(before_s, own_s, 2), before_s)
    assert abs(np.corrcoef(heights, own_s - explained)[0, 1]) < 0.15


def test_the_rate_falls_by_25_beats_in_the_first_minute_after_exercise() -> None:
    intervals_s = measure("after exercise, 100 Hz").intervals_s
    begins_s = np.cumsum(intervals_s)
    first = begins_s < 60
    slope = np.polyfit(begins_s[first], 60 / intervals_s[first], 1)[0]
    assert 60 * slope == pytest.approx(-25, abs=8)
    assert (60 / intervals_s[~first]).mean() == pytest.approx(128 - 25, abs=2)


def test_the_baseline_drifts_by_half_the_height_of_a_beat() -> None:
    name = "drift, 64 Hz"
    assert measure(name).feet.std() / height(name) == pytest.approx(0.5, abs=0.08)
    assert measure("gaps, 100 Hz").feet.std() / height("gaps, 100 Hz") < 0.15


def test_movement_is_a_part_of_the_truth_for_some_seconds() -> None:
    heights = measure("movement, 50 Hz").heights
    odd = np.abs(heights / np.median(heights) - 1) > 0.35
    assert 0.03 < odd.mean() < 0.3


def test_one_seed_gives_the_same_pulses_and_another_seed_others() -> None:
    once, again, other = (people_pulses(25.0, seed) for seed in (1, 1, 2))
    for first, second in zip(once, again, strict=True):
        assert first.name == second.name
        assert np.array_equal(first.sensed, second.sensed, equal_nan=True)
        assert np.array_equal(first.true, second.true)
    assert not np.array_equal(once[0].true, other[0].true)


def test_what_a_recording_sensed_is_its_truth() -> None:
    pytest.importorskip("heartpy", exc_type=ImportError)
    recorded = [pulse for name, pulse in pulses().items() if name not in PEOPLE]
    assert len(recorded) == 6
    for pulse in recorded:
        assert pulse.sensed is pulse.true
        assert 90 < pulse.rate_hz < 120
