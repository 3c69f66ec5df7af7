import math
from decimal import localcontext

import numpy as np
import pytest

from sensing_node.sources.synthetic import SyntheticScene
from telepulse.reports.paper.published import EXPERIMENT, FILM_MV
from telepulse.reports.studies.integrator_scores import (
    DERIVATIVE_FILTER_HZ,
    PAPER_PLANT,
    close_loop,
    decimal_pid,
    decimal_plant,
    decimals,
    loop_radius,
    paper_pid,
    pid_step,
    pulse_from_rest,
)
from telepulse.reports.studies.integrators import exact_hold, shipped

SCENE = SyntheticScene.model_validate({"kind": "synthetic", "preset": "paper"})


def test_the_pulse_begins_at_rest_and_has_the_scenes_height() -> None:
    for tick_s in (1e-4, 1e-3):
        pulse_n = pulse_from_rest(SCENE, 2.0, tick_s)
        assert len(pulse_n) == round(2.0 / tick_s)
        assert pulse_n[0] == 0.0
        assert np.ptp(pulse_n) == pytest.approx(SCENE.peak_to_peak_n, rel=1e-3)


def test_a_constant_error_gives_the_three_terms_of_table_5() -> None:
    tick_s, error_n = 1e-3, 0.002
    pid, memory = paper_pid(tick_s), (0.0, 0.0, 0.0)
    filter_s = 1 / (2 * math.pi * DERIVATIVE_FILTER_HZ)
    gains = EXPERIMENT
    for ticks in range(1, 6):
        volts, memory = pid_step(pid, memory, error_n)
        fading = (filter_s / (filter_s + tick_s)) ** (ticks - 1) / (filter_s + tick_s)
        factor = gains.kp + gains.ki * tick_s * ticks + gains.kd * fading
        assert volts == pytest.approx(factor * FILM_MV.per_newton * error_n, rel=1e-12)


def test_eq_21_gives_the_papers_millivolts() -> None:
    assert pytest.approx(5305, abs=0.5) == FILM_MV.per_newton


@pytest.mark.parametrize(("tick_s", "stable"), [(1e-4, True), (1e-3, True), (1e-2, False)])
def test_the_loop_is_stable_where_its_spectral_radius_is_below_1(
    tick_s: float, stable: bool
) -> None:
    pulse_n = pulse_from_rest(SCENE, 1.0, tick_s)
    forces_n, _ = close_loop(shipped(PAPER_PLANT, tick_s), paper_pid(tick_s), pulse_n)
    assert (loop_radius(PAPER_PLANT, tick_s) < 1) == stable
    assert (np.ptp(forces_n) < 2 * SCENE.peak_to_peak_n) == stable


def test_an_unstable_loop_grows_by_its_spectral_radius_a_tick() -> None:
    forces_n, _ = close_loop(shipped(PAPER_PLANT, 1e-2), paper_pid(1e-2), [1.0] + [0.0] * 299)
    early, late = (np.abs(forces_n[begin : begin + 50]).max() for begin in (50, 250))
    assert (late / early) ** (1 / 200) == pytest.approx(loop_radius(PAPER_PLANT, 1e-2), rel=0.01)


def test_the_loop_in_decimals_is_the_loop_in_floats() -> None:
    pulse_n = pulse_from_rest(SCENE, 0.5, 1e-3)
    forces_n, voltages = close_loop(shipped(PAPER_PLANT, 1e-3), paper_pid(1e-3), pulse_n)
    with localcontext(prec=40):
        step = exact_hold(decimal_plant(PAPER_PLANT), *decimals([1e-3]))
        exact_n, exact_volts = close_loop(step, decimal_pid(paper_pid(1e-3)), decimals(pulse_n))
    assert forces_n == pytest.approx([float(force) for force in exact_n], abs=1e-14)
    assert voltages == pytest.approx([float(volts) for volts in exact_volts], abs=1e-8)
