import numpy as np
import pytest

from telepulse.paper.published import ENERGY_BELOW_HZ
from telepulse.paper.pulse_spectrum import (
    RATE_HZ,
    SECONDS,
    Preset,
    beats,
    deviation_n,
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


def test_shares_by_sums_and_by_trapezoids() -> None:
    paper = spectra()["ours"]
    index = int(np.searchsorted(paper.frequency_hz, 5.0))
    assert paper.shares()[index - 1] == pytest.approx(paper.below(5.0))
    assert paper.shares()[-1] == pytest.approx(1)
    assert paper.below_by_trapezoids(5.0) == pytest.approx(0.572, abs=0.001)
    assert paper.below_by_trapezoids(10.0) == pytest.approx(0.906, abs=0.001)
    assert paper.below_by_trapezoids(1.0) < paper.below(1.0) - 0.02


def test_the_mean_decides_the_lowest_share_and_the_wide_pulse_is_slower() -> None:
    assert spectra()["beats alone, mean kept"].below(0.4) == pytest.approx(0.31, abs=0.01)
    assert spectra()["beats alone, mean removed"].below(0.4) == pytest.approx(1e-4, abs=5e-5)
    assert spectra()["wide"].below(5.0) == pytest.approx(0.935, abs=0.005)


@pytest.mark.parametrize("preset", ["paper", "wide"])
def test_beats_have_no_mean_and_one_newton(preset: Preset) -> None:
    force_n = beats(preset, 1000.0, 8.0)
    assert len(force_n) == 8001
    assert force_n[:-1].mean() == pytest.approx(0, abs=1e-6)
    assert np.ptp(force_n) == pytest.approx(1, abs=1e-3)


def test_slow_parts_are_in_units_of_the_beats_deviation() -> None:
    slow_n = beats("paper", 1000.0, 8.0, slow_parts=True) - beats("paper", 1000.0, 8.0)
    deviation = deviation_n("paper")
    assert slow_n[:-1].mean() == pytest.approx(0.034 * deviation, rel=1e-6)
    assert slow_n[:-1].std() == pytest.approx(0.256 * deviation, rel=1e-3)
