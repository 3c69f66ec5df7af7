import numpy as np
import pytest

from protocol.wire.messages import Frame
from protocol.wire.stream import Channel
from telepulse.recording.forces import BINS, AlignedBlock, AlignedTick, ForceAlignment, Trend
from tests.support.streams import description

MS = 1_000_000
BATCH = 5


def run(seconds: int, ratio: float, channel: int, group_delay_ns: int = 0) -> ForceAlignment:
    """Align a pulse on one of two channels, felt 1 mN too strong and 40 ms late."""
    chance = np.random.default_rng(1)
    blocks: list[AlignedBlock] = []
    alignment = ForceAlignment(blocks.append)
    stream = description(
        channels=(Channel("a"), Channel("b")), bytes_per_sample=8, group_delay_ns=group_delay_ns
    )
    t_s = np.arange(seconds * 1000) * 1e-3
    force_n = np.empty((len(t_s), 2))
    force_n[:, 1 - channel] = 0.4 + 0.01 * chance.standard_normal(len(t_s))
    force_n[:, channel] = 0.4 + 0.1 * np.sin(8 * t_s)
    for first in range(0, len(t_s), BATCH):
        values = force_n[first : first + BATCH]
        if first == 1000 * seconds // 2:
            alignment.set_playback(channel, ratio)
        alignment.add_frame(Frame(1, first, first * MS + group_delay_ns, MS, values), stream)
        for at in range(first, first + BATCH):
            if at >= 40:
                target_n = ratio * force_n[at - 40, channel]
                tick = AlignedTick(t_s[at], at * MS, (at - 40) * MS, target_n + 1e-3)
                alignment.add_tick(tick)
    alignment.finish()
    error_n = np.concatenate([block.felt_n - block.target_n for block in blocks])
    assert len(error_n) == len(t_s) - 40
    np.testing.assert_allclose(error_n, 1e-3)
    return alignment


@pytest.mark.parametrize("channel", [0, 1])
@pytest.mark.parametrize("ratio", [1.0, 0.25])
@pytest.mark.parametrize("seconds", [1, 4])
def test_ticks_before_the_first_status_are_scored(seconds: int, ratio: float, channel: int) -> None:
    alignment = run(seconds, ratio, channel)
    assert alignment.errors.force_rmse_n.aligned == pytest.approx(1e-3)


def test_the_pulse_is_earlier_than_its_samples_by_the_group_delay() -> None:
    alignment = run(3, 1.0, 0, group_delay_ns=7 * MS)
    assert alignment.errors.force_rmse_n.aligned == pytest.approx(1e-3)


def test_another_session_begins_anew() -> None:
    alignment = run(1, 0.5, 1)
    alignment.begin()
    assert alignment.ratio is None


@pytest.mark.parametrize("hours", [0.01, 1, 30])
def test_a_trend_of_any_length_fits_and_loses_no_value(hours: float) -> None:
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


def test_nan_is_left_out() -> None:
    trend = Trend(1.0)
    trend.add(np.array([0.0, 1.5, 1.6]), np.array([np.nan, 2.0, np.nan]))
    points = trend.points()
    assert (points.t_s.tolist(), points.low.tolist()) == ([1.5], [2.0])
