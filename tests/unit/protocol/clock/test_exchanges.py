import numpy as np
import pytest

from protocol.clock.exchanges import BLOCK, LEVELS, ClockExchange, block_offset
from protocol.clock.offset_regression import fit_lines

MS = 1_000_000
S = 1_000 * MS


def exchange(t_ns: int, there_ms: float, back_ms: float, offset_ns: int = 0) -> ClockExchange:
    arrives_ns = t_ns + round(there_ms * MS)
    shown_ns = arrives_ns + offset_ns
    return ClockExchange(t_ns, shown_ns, shown_ns, arrives_ns + round(back_ms * MS))


def test_levels_are_means_of_the_shortest_delays_of_each_way() -> None:
    there_ms, back_ms = [20, 50, 30, 40], [13, 11, 12, 10]
    block = [
        exchange(i * 20 * MS, there, back, 5 * MS)
        for i, (there, back) in enumerate(zip(there_ms, back_ms, strict=True))
    ]
    seen = block_offset(block, block[0], skew=0.0, skew_doubt=0.0)
    first_ns = block[0].offset_ns
    means = [(20, 10), (25, 10.5), (35, 11.5), (35, 11.5), (35, 11.5)]
    expected = [5 + (there - back) / 2 for there, back in means]
    assert (seen.offset_ns + first_ns) / MS == pytest.approx(expected)
    assert seen.round_trip_ns / MS == pytest.approx([there + back for there, back in means])
    assert len(expected) == len(LEVELS)


def test_a_skew_that_is_known_does_not_make_late_delays_look_short() -> None:
    skew = 500e-6
    block = [exchange(i * S, 20, 20, round(i * S * skew)) for i in range(BLOCK)]
    blind = block_offset(block, block[0], 0.0, 0.0)
    seeing = block_offset(block, block[0], skew, 0.0)
    assert seeing.round_trip_ns[0] == pytest.approx(40 * MS, abs=100_000)
    assert blind.round_trip_ns[0] < 34 * MS
    doubtful = block_offset(block, block[0], 0.0, 2 * skew)
    assert doubtful.round_trip_ns[0] > 40 * MS


def test_a_line_goes_through_points_and_says_how_sure_it_is() -> None:
    rng = np.random.default_rng(1)
    t_ns = np.arange(100) * 0.3 * S
    noise_ns = 1e5
    off, misses = [], []
    for _ in range(200):
        y_ns = 3e6 + 50e-6 * t_ns + rng.normal(0, noise_ns, 100)
        line = fit_lines(t_ns, y_ns[:, None], np.ones((100, 1)), noise_ns, 200e-6)
        off.append(float(line.at(30 * S)[0]) - 3e6 - 50e-6 * 30 * S)
        misses.append(abs(off[-1]) > 2 * float(line.error_at(30 * S)[0]))
    assert abs(np.mean(off)) < 0.2 * noise_ns
    assert 0.01 < np.mean(misses) < 0.1


def test_points_of_no_weight_do_not_count() -> None:
    t_ns = np.arange(20) * S
    y_ns = np.where(np.arange(20) % 2, 1e9, 2e6)
    weight = np.where(np.arange(20) % 2, 1e-12, 1.0)[:, None]
    line = fit_lines(t_ns, y_ns[:, None], weight, 1e3, 200e-6)
    assert float(line.at(20 * S)[0]) == pytest.approx(2e6, abs=2e3)


def test_two_points_close_together_give_no_wild_skew() -> None:
    t_ns, y_ns = np.array([0.0, 20 * MS]), np.array([[0.0], [1.0 * MS]])
    line = fit_lines(t_ns, y_ns, np.ones((2, 1)), 1e6, 200e-6)
    assert abs(line.skew[0]) < 200e-6
