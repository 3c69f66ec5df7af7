import numpy as np
import pytest

from protocol.errors import BenchError
from protocol.tactile import FIG_4_VOLTS_PER_NEWTON
from telepulse.commissioning.calibration import fit_line

UP_N = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5])
UP_AND_DOWN_N = np.concatenate([UP_N, UP_N[-2::-1]])


def test_fig_4s_line_is_found() -> None:
    line = fit_line(UP_N, FIG_4_VOLTS_PER_NEWTON * UP_N + 0.002)
    assert line.slope == pytest.approx(0.044)
    assert line.offset == pytest.approx(0.002)
    assert line.r_squared == pytest.approx(1.0)
    assert line.rms_n == pytest.approx(0.0, abs=1e-12)
    assert (line.hysteresis_n, line.repeatability_n) == (None, None)


def test_hysteresis_is_the_gap_between_the_ways_up_and_down() -> None:
    down = np.arange(11) > 5
    line = fit_line(UP_AND_DOWN_N, 44 * (UP_AND_DOWN_N + 0.02 * down))
    assert line.hysteresis_n == pytest.approx(0.02, rel=0.02)
    assert line.repeatability_n is None


def test_repeatability_is_the_spread_at_the_same_load_reached_the_same_way() -> None:
    rng = np.random.default_rng(1)
    load_n = np.tile(UP_N, 100)
    line = fit_line(load_n, 44 * (load_n + 0.01 * rng.standard_normal(600)))
    assert line.repeatability_n == pytest.approx(0.01, rel=0.1)
    # From 2.5 N back to 0 N is the way down: all but the first of the zeros came so.
    assert line.hysteresis_n == pytest.approx(0.0, abs=0.03)


@pytest.mark.parametrize(
    ("load_n", "reading", "reason"),
    [
        ([0, 1], [0, 44], "2 loads; at least 3"),
        ([1, 1, 1], [44, 45, 46], "all loads are 1 N"),
        ([0, 1, 2], [5, 5, 5], "do not change"),
        # Noise alone.
        ([0, 1, 2, 1, 0], [8184, 8185, 8184, 8183, 8184], "do not change"),
    ],
)
def test_loads_without_a_line_are_refused(
    load_n: list[float], reading: list[float], reason: str
) -> None:
    with pytest.raises(BenchError, match=reason):
        fit_line(np.array(load_n, float), np.array(reading, float))
