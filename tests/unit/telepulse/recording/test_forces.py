from collections.abc import Sequence

import numpy as np
import pytest

from protocol.wire.description import Channel
from protocol.wire.messages import Frame
from protocol.wire.telemetry import PlaybackStatus
from telepulse.columns import SessionColumns, TickRow
from telepulse.recording.forces import BINS, ContactorFindings, find_trend
from tests.support.streams import description

MS = 1_000_000
BATCH, LATE = 5, 40


def pulse_session(
    seconds: float,
    ratio: float = 1.0,
    channel: int = 0,
    group_delay_ns: int = 0,
    film_age_ns: int = 0,
    early_ticks: int = 0,
    names: Sequence[str] = ("cun",),
) -> SessionColumns:
    """Return a pulse on one of two channels, felt 1 mN too strong and 40 ms late.

    early_ticks: number of ticks at full strength before the first frame. names: of the contactors,
    of which each feels a further mN too much.
    """
    chance = np.random.default_rng(1)
    stream = description(
        channels=(Channel("a"), Channel("b")), bytes_per_sample=8, group_delay_ns=group_delay_ns
    )
    session = SessionColumns(1, stream)
    for name in names:
        played = PlaybackStatus(name, channel, ratio, -4.8e-6, "linear", 60 * MS, film_age_ns)
        session.playing[name] = played
    t_s = np.arange(round(seconds * 1000)) * 1e-3
    force_n = np.empty((len(t_s), 2))
    force_n[:, 1 - channel] = 0.4 + 0.01 * chance.standard_normal(len(t_s))
    force_n[:, channel] = 0.4 + 0.1 * np.sin(8 * t_s)
    for at_ns in range(-early_ticks * MS, 0, MS):
        tick = TickRow(at_ns, at_ns, at_ns - LATE * MS, True, True, True, False, at_ns)
        session.add_tick(tick, [(0.4, 0.4)])
    for first in range(0, len(t_s), BATCH):
        values = force_n[first : first + BATCH]
        session.add_frame(Frame(1, first, first * MS + group_delay_ns, MS, values))
        for at in range(first, first + BATCH):
            now_ns = at * MS + film_age_ns
            tick = TickRow(now_ns, now_ns, now_ns - LATE * MS, True, True, at >= LATE, False)
            target_n = ratio * force_n[max(0, at - LATE), channel]
            forces_n = [(target_n, target_n + 1e-3 * (1 + n)) for n in range(len(names))]
            session.add_tick(tick._replace(unix_ns=now_ns), forces_n)
    return session


def findings(*sessions: SessionColumns) -> ContactorFindings:
    found = ContactorFindings("cun", sessions, 0)
    assert found.errors.force_rmse_n.aligned == pytest.approx(1e-3)
    np.testing.assert_allclose(found.error_n.mean, 1e-3)
    for block in found.first:
        known = ~np.isnan(block.pulse_n)
        np.testing.assert_allclose((block.felt_n - block.pulse_n)[known], 1e-3)
    return found


@pytest.mark.parametrize("channel", [0, 1])
@pytest.mark.parametrize("ratio", [1.0, 0.25])
@pytest.mark.parametrize("seconds", [1, 4])
def test_each_tick_is_compared_with_the_instant_that_it_plays(
    seconds: int, ratio: float, channel: int
) -> None:
    found = findings(pulse_session(seconds, ratio, channel))
    assert (found.ratio, found.channel) == (ratio, channel)
    assert sum(len(block.t_s) for block in found.first) == 1000 * seconds - LATE


def test_the_pulse_is_earlier_than_its_samples_by_the_group_delay() -> None:
    findings(pulse_session(3, group_delay_ns=7 * MS))


def test_a_films_reading_is_compared_with_the_time_at_which_it_was_felt() -> None:
    findings(pulse_session(3, film_age_ns=9 * MS))


def test_sessions_are_aligned_each_with_its_own_samples_and_channel() -> None:
    findings(pulse_session(3), SessionColumns(2), pulse_session(4, 0.5, 1, 3 * MS))


@pytest.mark.parametrize("seconds", [4.2, 9])
def test_the_band_is_of_whole_beats_also_at_the_end(seconds: float) -> None:
    found = findings(pulse_session(seconds))
    # The pulse has 0.2 N from peak to peak.
    assert len(found.jnd_n.t_s) > 10 * (seconds - 1)
    np.testing.assert_allclose([found.jnd_n.low, found.jnd_n.high], 0.02, rtol=1e-3)


def test_ticks_before_a_sessions_first_frame_have_an_unknown_pulse() -> None:
    # As where the display was started again, and the recording missed the begin of its session.
    found = findings(pulse_session(3, early_ticks=700))
    assert found.first[0].t_s[0] == pytest.approx(-0.7)
    assert np.isnan(found.first[0].pulse_n[:700]).all()


@pytest.mark.parametrize("hours", [0.01, 1, 30])
def test_a_trend_of_any_length_fits_and_loses_no_value(hours: float) -> None:
    chance = np.random.default_rng(1)
    times_s = np.sort(chance.uniform(0, hours * 3600, 20_000))
    values = chance.normal(size=20_000)
    points = find_trend(times_s, values)
    assert len(points.t_s) <= BINS
    assert (points.low.min(), points.high.max()) == (values.min(), values.max())
    assert points.total.sum() == pytest.approx(values.sum())
    for at in (0, len(points.t_s) // 2):
        here = np.abs(times_s - points.t_s[at]) < points.width_s / 2
        assert points.mean[at] == pytest.approx(values[here].mean())
        assert points.high[at] == values[here].max()


def test_nan_is_left_out() -> None:
    points = find_trend(np.array([0.0, 1.5, 1.6]), np.array([np.nan, 2.0, np.nan]), 1.0)
    assert (points.t_s.tolist(), points.low.tolist()) == ([1.5], [2.0])
