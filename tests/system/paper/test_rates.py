"""The paper's gains over tick rates: the explicit loop beside the shipped one."""

import math

import pytest

from telepulse.paper.pulse_spectrum import deviation_n
from telepulse.paper.stability import PEAK_TO_PEAK_N, RATES_HZ, RateResult, measure


@pytest.fixture(scope="module")
def rates() -> list[RateResult]:
    return measure()


def test_the_shipped_pid_follows_at_every_rate_and_the_explicit_one_where_its_poles_allow(
    rates: list[RateResult],
) -> None:
    assert len(rates) == 4 * len(RATES_HZ)
    for each in rates:
        assert each.refused is None
        assert each.shipped_radius < 1
        assert each.shipped_n < 2e-3, each
        assert math.isinf(each.explicit_n) == (each.explicit_radius > 1), each
        if each.rate_hz == 10_000 and each.gains == "experiment":
            assert each.shipped_n == pytest.approx(each.explicit_n, rel=0.01)
    bare_n = {(each.gains, each.rate_hz): each.explicit_n for each in rates if each.filter_hz > 1e4}
    assert math.isinf(bare_n["simulation", 1_000])
    assert bare_n["experiment", 1_000] < 2e-3
    assert math.isinf(bare_n["experiment", 200])


def test_the_delay_margin_predicts_the_effect_of_a_tick_of_delay(rates: list[RateResult]) -> None:
    nothing_n = PEAK_TO_PEAK_N * deviation_n("paper")
    lost = {(each.gains, each.rate_hz) for each in rates if each.late_n > nothing_n}
    assert lost == {("simulation", 100), ("experiment", 100), ("experiment", 200)}
    for each in rates:
        assert (each.margin_ticks < 1.025) == (each.late_n > nothing_n)
