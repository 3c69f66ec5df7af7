import pytest

from display_node.plant.scene import FilmTable
from telepulse.paper import stepper
from telepulse.paper.stepper import BenchResult
from tests.support.nodes import known

CLEAN_BAR_N = 0.3e-3
REAL_BAR_N = 4e-3


def rmse_n(results: list[BenchResult]) -> dict[str, float]:
    return {result.name: known(result.force_rmse_n) for result in results}


def test_the_shipped_benches_are_those_of_the_bars() -> None:
    clean, real = stepper.load_bench("bench").display, stepper.load_bench().display
    for display in (clean, real):
        assert display.actuator.kind == "stepper"
        assert (display.actuator.microsteps, display.actuator.lead_m) == (16, 2e-3)
        assert display.actuator.fingertip_n_per_m == 1e3
    assert clean.film == FilmTable()
    assert (real.film.filter_hz, real.film.noise_n, real.film.adc_bits) == (40, 1e-3, 16)
    assert real.actuator.kind == "stepper"
    assert real.actuator.backlash_m == pytest.approx(10e-6)
    assert (real.actuator.rotor_resonance_hz, real.actuator.rotor_damping) == (100, 0.2)


def test_the_clean_bench_is_at_the_microsteps_floor() -> None:
    clean = stepper.load_bench("bench")
    microstep_rmse_n = stepper.microstep_rmse_n(clean)
    assert microstep_rmse_n == pytest.approx(0.18e-3, abs=0.01e-3)
    shipped_n = known(stepper.run_controllers(clean)[-1].force_rmse_n)
    assert microstep_rmse_n <= shipped_n <= CLEAN_BAR_N


def test_only_an_observer_follows_on_the_real_bench() -> None:
    papers, *others = stepper.run_controllers(stepper.load_bench())
    assert papers.force_rmse_n is None
    assert "not stable" in papers.refused
    proportional, fed_forward, observed, shipped = rmse_n(others).values()
    assert proportional > REAL_BAR_N < fed_forward
    assert 0 < max(observed, shipped) <= REAL_BAR_N / 2
