import pytest

from telepulse.reports.paper import comparison


def test_the_actuator_by_its_own_numbers() -> None:
    assert comparison.natural_frequency_hz() == pytest.approx(0.41, abs=0.005)
    volts = comparison.volts_for_one_newton()
    assert volts == pytest.approx(2460, abs=5)
    assert 10 / volts == pytest.approx(4e-3, abs=1e-4)
