import numpy as np
import pytest

from telepulse.paper.published import ENERGY_BELOW_HZ
from telepulse.paper.pulse_spectrum import (
    RATE_HZ,
    SECONDS,
    spectra,
    welch,
)


@pytest.mark.parametrize(("limit_hz", "share"), ENERGY_BELOW_HZ.items())
def test_energy_shares_within_a_percentage_point(limit_hz: float, share: float) -> None:
    assert spectra()["ours"].below(limit_hz) == pytest.approx(share, abs=0.01)


def test_shares_of_two_waves_of_known_energy() -> None:
    t_s = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    # Energies 9 and 1 in units of half a newton squared.
    spectrum = welch(3 * np.sin(2 * np.pi * 6 * t_s) + np.sin(2 * np.pi * 30 * t_s))
    for share in (spectrum.below, spectrum.below_by_trapezoids):
        assert share(3) == pytest.approx(0, abs=1e-4)
        assert share(15) == pytest.approx(0.9, abs=1e-3)
        assert share(60) == pytest.approx(1, abs=1e-4)
