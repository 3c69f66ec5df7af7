"""Statistics of beats, and the pulse alarm."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.scoring.beat_statistics import BeatStatistics, pulse_alarm
from protocol.summary.fields import BeatFigures
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource
from tests.support.drawn_beats import PERIOD_NS, samples

Floats = NDArray[np.float64]
SECOND_NS = 1_000_000_000


def pulse(seconds: float, **settings: str) -> Floats:
    scene = SyntheticScene.model_validate({"kind": "synthetic", "seed": 2} | settings)
    return SyntheticSource(scene).take(round(seconds * 1000))[:, 0]


def feed(statistics: BeatStatistics, force_n: Floats, begin_ns: int = 0) -> int:
    """Take samples in frames of 5 ms; return the time after the last one."""
    for first in range(0, len(force_n), 5):
        frame = samples(begin_ns + first * PERIOD_NS, force_n[first : first + 5])
        statistics.observe(frame)
    return begin_ns + len(force_n) * PERIOD_NS


def test_figures_are_those_of_the_pulse() -> None:
    statistics = BeatStatistics()
    assert statistics.figures() == BeatFigures()
    feed(statistics, pulse(30, heart_rate="75 /min", heart_rate_variability="4 %", noise="0.5 mN"))
    # At the finger of another layer the pulse has a quarter of its height.
    found = statistics.figures(force_ratio=0.25)
    assert found.height_at_finger_n == pytest.approx(0.075, rel=0.03)
    assert statistics.figures() == replace(found, height_at_finger_n=None)
    assert found.count == pytest.approx(30 * 1.25, abs=4)
    assert found.rate_per_min == pytest.approx(75, rel=0.03)
    assert found.variability_ms == pytest.approx(0.04 * 800, rel=0.3)
    assert found.height_n == pytest.approx(0.3, rel=0.03)
    assert found.upstroke_ms == pytest.approx(92, rel=0.1)
    assert found.notch_ms == pytest.approx(330, rel=0.1)
    assert found.quality == pytest.approx(1.0, abs=0.02)
    assert (found.doubtful, found.alarm) == (0.0, False)
    assert pulse_alarm({"alarm": found.alarm}) is None


def test_medians_are_of_the_last_minute_and_counts_of_the_run() -> None:
    statistics = BeatStatistics()
    end_ns = feed(statistics, pulse(40, heart_rate="60 /min"))
    before = statistics.figures()
    feed(statistics, pulse(70, heart_rate="120 /min"), end_ns)
    after = statistics.figures()
    assert before.rate_per_min == pytest.approx(60, rel=0.02)
    assert after.rate_per_min == pytest.approx(120, rel=0.02)
    assert before.count is not None
    assert after.count == pytest.approx(before.count + 140, abs=4)


@pytest.mark.parametrize("kind", ["noise", "silence"])
def test_a_signal_that_is_no_pulse_raises_the_alarm_and_a_pulse_ends_it(kind: str) -> None:
    statistics = BeatStatistics()
    end_ns = feed(statistics, pulse(20))
    assert not statistics.figures().alarm
    noise = np.random.default_rng(1).standard_normal(8_000)
    end_ns = feed(statistics, 0.3 + 0.1 * noise * (kind == "noise"), end_ns)
    wrong = statistics.figures()
    assert wrong.alarm
    assert wrong.quality is not None
    assert wrong.quality < 0.5
    text = pulse_alarm({"alarm": wrong.alarm, "quality": wrong.quality})
    assert text is not None
    assert text.startswith("the received signal is no regular pulse (quality 0.")
    feed(statistics, pulse(20), end_ns)
    found = statistics.figures()
    assert not found.alarm
    assert found.quality == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("gap_s", [0.3, 2.0, 4.0, 12.0])
@pytest.mark.parametrize("rate_per_min", [45, 75])
def test_after_a_gap_figures_begin_anew_and_no_alarm_is_raised(
    gap_s: float, rate_per_min: int
) -> None:
    statistics, force_n = BeatStatistics(), pulse(40, heart_rate=f"{rate_per_min} /min")
    before, after = list[BeatFigures](), list[BeatFigures]()
    for first in range(0, len(force_n), 50):
        at_s = first * 1e-3
        if not 20.1 <= at_s < 20.1 + gap_s:
            statistics.observe(samples(first * PERIOD_NS, force_n[first : first + 50]))
            (before if at_s < 20.1 else after).append(statistics.figures())
    assert not any(found.alarm for found in before + after)
    assert before[-1].quality == after[-1].quality == pytest.approx(1.0, abs=0.02)
    assert after[0] == BeatFigures(count=before[-1].count, doubtful=0.0, alarm=False)
    assert after[-1].rate_per_min == pytest.approx(rate_per_min, rel=0.02)


def test_gaps_that_come_faster_than_beats_are_found_raise_no_alarm() -> None:
    statistics, force_n = BeatStatistics(), pulse(30)
    for first in range(0, len(force_n), 50):
        if first % 2_000 >= 150:
            statistics.observe(samples(first * PERIOD_NS, force_n[first : first + 50]))
        assert not statistics.figures().alarm


def test_the_first_three_beats_have_no_quality() -> None:
    statistics = BeatStatistics()
    feed(statistics, pulse(4.5))
    found = statistics.figures()
    assert found.count in (1, 2, 3)
    assert found.quality is None


def test_a_session_on_another_clock_begins_anew_and_the_counts_go_on() -> None:
    statistics = BeatStatistics()
    feed(statistics, pulse(20), 50 * SECOND_NS)
    before = statistics.figures().count
    statistics.restart()
    feed(statistics, pulse(20, peak_to_peak="0.1 N"), 10 * SECOND_NS)
    after = statistics.figures()
    assert before is not None
    assert after.count == 2 * before
    assert after.height_n == pytest.approx(0.1, rel=0.03)
