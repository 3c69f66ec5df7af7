import numpy as np
import pytest

from telepulse.recording.report.trend import BINS, Trend


@pytest.mark.parametrize("hours", [0.01, 1, 30])
def test_a_time_of_any_length_fits_and_nothing_is_lost_of_it(hours: float) -> None:
    trend, chance = Trend(), np.random.default_rng(1)
    times_s = np.sort(chance.uniform(0, hours * 3600, 20_000))
    values = chance.normal(size=20_000)
    for part in range(0, 20_000, 700):
        trend.add(times_s[part : part + 700], values[part : part + 700])
    points = trend.points()
    assert len(points.t_s) <= BINS
    assert (points.low.min(), points.high.max()) == (values.min(), values.max())
    assert points.total.sum() == pytest.approx(values.sum())
    for at in (0, len(points.t_s) // 2):
        here = np.abs(times_s - points.t_s[at]) < trend.width_s / 2
        assert points.mean[at] == pytest.approx(values[here].mean())
        assert points.high[at] == values[here].max()


def test_what_is_no_number_is_left_out() -> None:
    trend = Trend(1.0)
    trend.add(np.array([0.0, 1.5, 1.6]), np.array([np.nan, 2.0, np.nan]))
    points = trend.points()
    assert (points.t_s.tolist(), points.low.tolist()) == ([1.5], [2.0])
