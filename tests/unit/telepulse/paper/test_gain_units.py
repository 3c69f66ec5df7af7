import numpy as np
import pytest
from scipy.signal import lsim

from telepulse.paper import gain_units
from telepulse.paper.gain_units import relative_rmse
from telepulse.paper.published import (
    ERROR_UNITS,
    EXPERIMENT,
    GAINS,
    SIMULATION,
    ErrorUnit,
    Gains,
)
from telepulse.paper.pulse_spectrum import beats, deviation_n


def test_each_unit_has_its_error() -> None:
    found = {
        unit.name: tuple(relative_rmse(unit, gains) for gains in GAINS.values())
        for unit in ERROR_UNITS
    }
    assert found == {
        "strain": pytest.approx((0.238, 0.238), rel=0.004),
        "N": pytest.approx((0.295, 0.325), rel=0.004),
        "V by eq 21": pytest.approx((0.242, 0.259), rel=0.004),
        "mV by Fig. 4": pytest.approx((0.171, 0.349), rel=0.004),
        "mV by eq 21": pytest.approx((0.00222, 0.0065), rel=0.004),
    }
    assert deviation_n("paper") == pytest.approx(0.233, abs=0.0005)


@pytest.mark.parametrize("unit", ERROR_UNITS, ids=lambda unit: str(unit.name))
@pytest.mark.parametrize("gains", [SIMULATION, EXPERIMENT], ids=["simulation", "experiment"])
def test_the_response_is_that_of_scipys_lsim(unit: ErrorUnit, gains: Gains) -> None:
    wanted_n = beats("paper", 5000.0, 0.8)
    t_s = np.arange(len(wanted_n)) / 5000.0
    felt_n = lsim(gain_units.closed_loop(unit, gains), wanted_n, t_s)[1]
    np.testing.assert_allclose(gain_units.follow(unit, gains, wanted_n, 5000.0), felt_n, atol=1e-12)
