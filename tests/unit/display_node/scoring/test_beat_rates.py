"""Rates of clean pulses of several shapes, and rates that are beyond the counted range."""

from dataclasses import asdict

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.scoring.beat_statistics import BeatStatistics, pulse_alarm
from display_node.scoring.heart_rate import heart_rate_per_min
from protocol.summary.fields import BeatFigures
from sensing_node.sources.heart import NOMINAL_BEAT_S
from sensing_node.sources.synthetic import PRESETS, Wave
from telepulse import find_beats
from tests.support.drawn_beats import samples

Floats = NDArray[np.float64]
# Waves of a beat of 0.8 s, and the power of the interval with which they shorten: half as in the
# synthetic source, or in proportion.
SHAPES = {
    "wide": (PRESETS["wide"], 0.5),
    "paper": (PRESETS["paper"], 0.5),
    "deep notch": ((Wave(1.0, 0.14, 0.045), Wave(0.5, 0.40, 0.05)), 0.5),
    "deep notch, in proportion": ((Wave(1.0, 0.12, 0.035), Wave(0.6, 0.42, 0.05)), 1.0),
}
RATES = [20, 75, 180, 240, 260, 300]


def drawn(shape: str, per_min: float, rate_hz: int, seconds: float) -> Floats:
    waves, power = SHAPES[shape]
    interval_s = 60 / per_min
    stretch = (interval_s / NOMINAL_BEAT_S) ** power
    t_s = np.arange(round(seconds * rate_hz)) / rate_hz
    force_n = np.full(len(t_s), 0.3)
    for wave in waves:
        # Of the beat that began last and of those around it.
        for number in range(-2, 3):
            since_s = t_s % interval_s + number * interval_s - wave.centre_s * stretch
            force_n += 0.3 * wave.amplitude * np.exp(-0.5 * (since_s / wave.width_s / stretch) ** 2)
    return force_n


def observed(force_n: Floats, rate_hz: int) -> BeatFigures:
    statistics, period_ns = BeatStatistics(), round(1e9 / rate_hz)
    for first in range(0, len(force_n), 5):
        statistics.observe(samples(first * period_ns, force_n[first : first + 5], period_ns))
    return statistics.figures()


# At 60 Hz a wave of the preset "paper" is narrower than two samples.
@pytest.mark.parametrize(
    ("shape", "rate_hz"),
    [(shape, hz) for shape in SHAPES for hz in (60, 128, 1000) if (shape, hz) != ("paper", 60)],
)
def test_rates_from_20_to_300_are_counted(shape: str, rate_hz: int) -> None:
    for per_min in RATES:
        seconds = max(12.0, 12 * 60 / per_min)
        found = observed(drawn(shape, per_min, rate_hz, seconds), rate_hz)
        assert found.rate_per_min == pytest.approx(per_min, rel=0.02)
        # The first one is found after 1.25 s, and the last one is not complete.
        assert found.count == pytest.approx(seconds * per_min / 60, abs=3 + 2 * per_min / 60)
        assert found.quality is not None
        assert found.quality > 0.8
        assert (found.doubtful, found.alarm) == (0.0, False)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    ("per_min", "limit"), [(330, "above the 300"), (600, "above the 300"), (15, "below the 20")]
)
def test_a_rate_beyond_the_range_is_reported_as_such(shape: str, per_min: int, limit: str) -> None:
    found = observed(drawn(shape, per_min, 500, max(12.0, 12 * 60 / per_min)), 500)
    assert found.rate_per_min == pytest.approx(per_min, rel=0.02)
    text = (
        f"the received pulse is {limit} /min that are counted: check the sensor's place and contact"
    )
    assert pulse_alarm(asdict(found)) == text


@pytest.mark.parametrize("per_min", [800, 1000])
def test_no_part_of_a_vibration_s_rate_is_within_the_range(per_min: int) -> None:
    found = observed(drawn("wide", per_min, 1000, 12.0), 1000)
    assert found.rate_per_min is not None
    assert found.rate_per_min > 306
    assert found.alarm


@pytest.mark.parametrize("per_min", [75, 240, 260])
def test_the_rate_that_is_felt_and_the_beats_of_an_array_are_right(per_min: int) -> None:
    for shape in SHAPES:
        force_n = drawn(shape, per_min, 1000, 10.0)
        intervals_s = [beat.interval_s for beat in find_beats(force_n, 1000)]
        assert intervals_s == pytest.approx([60 / per_min] * len(intervals_s), rel=0.05)
        assert len(intervals_s) > 7 * per_min / 60
        felt_n = force_n[-6000:]
        found = heart_rate_per_min(np.arange(6000) * 1e-3, felt_n)
        assert found == pytest.approx(per_min, rel=0.02)


@pytest.mark.parametrize("per_min", [330, 480])
def test_no_rate_is_felt_above_300(per_min: int) -> None:
    force_n = drawn("wide", per_min, 1000, 6.0)
    assert heart_rate_per_min(np.arange(6000) * 1e-3, force_n) is None
