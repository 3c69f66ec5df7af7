import numpy as np
import pytest
from scipy.signal import lsim

from telepulse.paper import gain_units
from telepulse.paper.published import (
    ERROR_UNITS,
    EXPERIMENT,
    SIMULATION,
    ErrorUnit,
    Gains,
)
from telepulse.paper.pulse_spectrum import beats


@pytest.mark.parametrize("unit", ERROR_UNITS, ids=lambda unit: str(unit.name))
@pytest.mark.parametrize("gains", [SIMULATION, EXPERIMENT], ids=["simulation", "experiment"])
def test_the_response_is_that_of_scipys_lsim(unit: ErrorUnit, gains: Gains) -> None:
    wanted_n = beats("paper", 5000.0, 0.8)
    t_s = np.arange(len(wanted_n)) / 5000.0
    felt_n = lsim(gain_units.closed_loop(unit, gains), wanted_n, t_s)[1]
    np.testing.assert_allclose(gain_units.follow(unit, gains, wanted_n, 5000.0), felt_n, atol=1e-12)
