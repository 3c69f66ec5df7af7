import numpy as np
import pytest
from scipy.signal import lsim

from telepulse.paper import gain_units
from telepulse.paper.gain_units import height_n, relative_rmse
from telepulse.paper.published import (
    ERROR_UNITS,
    EXPERIMENT,
    FILM_MV,
    GAINS,
    LAYER,
    MEASURED_FORCE,
    MEASURED_STRAIN,
    PRINTED,
    SIMULATED_STRAIN,
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


def test_the_error_is_a_mean_over_time() -> None:
    # The square of a line from 0 to 1 has the mean 1/3.
    assert gain_units.rmse(np.linspace(0, 1, 1001)) == pytest.approx(3**-0.5, rel=1e-5)


def test_the_printed_errors_as_forces() -> None:
    millinewtons = [1e3 * printed.force_n for printed in PRINTED]
    assert millinewtons == pytest.approx([1.974, 20.863, 12.106], abs=5e-4)
    assert pytest.approx(9.961e-8, abs=5e-12) == MEASURED_FORCE.force_n * abs(
        LAYER.strain_per_newton
    )
    assert MEASURED_STRAIN.force_n / MEASURED_FORCE.force_n == pytest.approx(0.58, abs=0.005)


def test_eq_21_in_millivolts_gives_each_error_at_another_height() -> None:
    heights_n = [height_n(FILM_MV, printed) for printed in PRINTED]
    assert heights_n == pytest.approx([0.888, 3.20, 1.86], rel=0.004)
    assert heights_n[0] * relative_rmse(FILM_MV, EXPERIMENT) == pytest.approx(5.8e-3, abs=5e-5)
    wanted_n = height_n(FILM_MV, SIMULATED_STRAIN) * beats("paper", gain_units.RATE_HZ, 6.0)
    error = LAYER.strain(gain_units.follow(FILM_MV, SIMULATION, wanted_n) - wanted_n)
    assert gain_units.rmse(error) == pytest.approx(9.4249e-9, rel=1e-9)


def test_no_unit_gives_two_of_the_printed_errors_at_one_height() -> None:
    for unit in ERROR_UNITS:
        simulated_n, force_n, strain_n = (height_n(unit, printed) for printed in PRINTED)
        assert force_n / strain_n == pytest.approx(MEASURED_FORCE.force_n / MEASURED_STRAIN.force_n)
        assert strain_n > 1.5 * simulated_n


def test_starting_on_the_pulse_is_easier() -> None:
    settled = relative_rmse(FILM_MV, SIMULATION, from_rest=False)
    assert 0.9 < settled / relative_rmse(FILM_MV, SIMULATION) < 0.97


def test_the_fastest_poles() -> None:
    assert gain_units.poles(FILM_MV, SIMULATION)[0] == pytest.approx(-4056, abs=0.5)
    pair = gain_units.poles(FILM_MV, EXPERIMENT)[:2]
    assert pair[0] == pair[1].conjugate()
