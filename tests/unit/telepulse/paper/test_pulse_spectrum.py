import numpy as np
import pytest

from telepulse.paper.pulse_spectrum import (
    RATE_HZ,
    SECONDS,
    welch,
)


def test_shares_of_two_waves_of_known_energy() -> None:
    t_s = np.arange(round(SECONDS * RATE_HZ)) / RATE_HZ
    # Energies 9 and 1 in units of half a newton squared.
    spectrum = welch(3 * np.sin(2 * np.pi * 6 * t_s) + np.sin(2 * np.pi * 30 * t_s))
    for share in (spectrum.below, spectrum.below_by_trapezoids):
        assert share(3) == pytest.approx(0, abs=1e-4)
        assert share(15) == pytest.approx(0.9, abs=1e-3)
        assert share(60) == pytest.approx(1, abs=1e-4)
