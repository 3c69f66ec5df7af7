import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.tissue import PASCALS_PER_MMHG, StiffeningLaw, TubeLaw

DIASTOLIC_PA, SYSTOLIC_PA = 80 * PASCALS_PER_MMHG, 120 * PASCALS_PER_MMHG
PRESSURES = st.floats(-4e4, 4e4)


@given(PRESSURES)
def test_the_compliance_falls_by_babbs_constants_on_either_side_of_zero(pressure_pa: float) -> None:
    tube, step_pa = TubeLaw(), 1.0
    compliance = (tube.volume(pressure_pa + step_pa) - tube.volume(pressure_pa - step_pa)) / (
        2 * step_pa
    )
    rate = 0.11 if pressure_pa < 0 else -0.03
    expected = math.exp(rate * pressure_pa / PASCALS_PER_MMHG)
    assert compliance == pytest.approx(expected, rel=2e-3, abs=1e-9)


@given(st.floats(0.1, 0.5))
def test_the_pulse_is_highest_at_the_mean_pressure(mean_share: float) -> None:
    tube = TubeLaw.highest_at_mean(mean_share)
    mean_pa = DIASTOLIC_PA + mean_share * (SYSTOLIC_PA - DIASTOLIC_PA)
    best = tube.height(mean_pa, DIASTOLIC_PA, SYSTOLIC_PA)
    for other_pa in (0.9 * mean_pa, 1.1 * mean_pa):
        assert tube.height(other_pa, DIASTOLIC_PA, SYSTOLIC_PA) < best


def test_a_closed_artery_has_next_to_no_pulse_and_no_diastole() -> None:
    tube = TubeLaw.highest_at_mean(0.27)
    at_mean = tube.height(90 * PASCALS_PER_MMHG, DIASTOLIC_PA, SYSTOLIC_PA)
    closed = tube.height(180 * PASCALS_PER_MMHG, DIASTOLIC_PA, SYSTOLIC_PA)
    assert closed < 0.01 * at_mean
    # The lower half of the pressure pulse moves nearly nothing.
    half_pa = (DIASTOLIC_PA + SYSTOLIC_PA) / 2
    low = tube.height(140 * PASCALS_PER_MMHG, DIASTOLIC_PA, half_pa)
    assert low < 0.15 * tube.height(140 * PASCALS_PER_MMHG, DIASTOLIC_PA, SYSTOLIC_PA)


@given(st.floats(0, 10), st.floats(0.3, 3))
def test_depth_and_force_are_inverse_and_the_stiffness_is_the_slope(
    force_n: float, scale: float
) -> None:
    law = StiffeningLaw(length_m=1.2e-3 / scale)
    depth_m = law.depth_m(force_n)
    assert law.force_n(depth_m) == pytest.approx(force_n, abs=1e-12)
    step_m = 1e-8
    slope = (law.force_n(depth_m + 2 * step_m) - law.force_n(depth_m + step_m)) / step_m
    assert law.stiffness_n_per_m(force_n) == pytest.approx(slope, rel=1e-3)
    assert law.stiffness_n_per_m(force_n) == pytest.approx(
        scale * StiffeningLaw().stiffness_n_per_m(force_n)
    )


def test_no_contact_is_no_force() -> None:
    assert StiffeningLaw().force_n(-1e-3) == 0.0
    assert StiffeningLaw().depth_m(-1.0) == 0.0
