import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from display_node.press.artery_law import HIGHEST, LOWEST, ArteryLaw
from display_node.press.tissue_model import LEAST_CHANGE_N, PulseCurve, StiffnessFit
from protocol.tissue import PASCALS_PER_MMHG, StiffeningLaw
from sensing_node.sources.wrist import Artery, WristScene

VISITED_N = (0.5, 0.7, 0.9, 1.1, 1.3, 1.5)
BETWEEN_N = (0.6, 0.8, 1.0, 1.2, 1.4)


def artery(**keys: Any) -> Artery:
    return Artery(WristScene.model_validate({"kind": "wrist"} | keys), 0.27)


def foot_share(force_n: float) -> float:
    """Return the foot's level of a film whose zero is the mean of a pulse that flattens."""
    return -0.45 + 0.2 * force_n


def learnt(truth: Artery, rounds: int = 5, noise: float = 0.02) -> PulseCurve:
    curve, random = PulseCurve(3.0), np.random.default_rng(1)
    for _ in range(rounds):
        for force_n in VISITED_N:
            height_n = truth.height_n(force_n)
            curve.observe(
                force_n,
                foot_share(force_n) * height_n,
                height_n * (1 + noise * random.standard_normal()),
            )
    return curve


@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"systolic": "13 kPa", "diastolic": "8.5 kPa"},
        {"systolic": "19 kPa", "diastolic": "12 kPa", "peak_to_peak": "1 N"},
    ],
    ids=["typical", "low pressure", "high pressure"],
)
def test_thirty_beats_give_the_height_within_a_tenth_also_between_them(
    keys: dict[str, str],
) -> None:
    truth = artery(**keys)
    curve = learnt(truth)
    for force_n in (*VISITED_N, *BETWEEN_N):
        assert curve.height(force_n) == pytest.approx(truth.height_n(force_n), rel=0.1), force_n
        assert curve.foot(force_n) == pytest.approx(foot_share(force_n), abs=0.05)
    assert curve.beats == 30


def test_the_deviation_is_small_where_beats_were_learnt_and_large_elsewhere() -> None:
    curve = learnt(artery())
    assert curve.deviation(0.9) < 0.1 < 1.0 < curve.deviation(2.9)


@pytest.mark.parametrize("mean_mmhg", [70, 100, 130])
def test_forces_never_visited_are_predicted_by_the_law_of_any_wrist(mean_mmhg: int) -> None:
    low_mmhg = mean_mmhg - 0.27 * 40
    truth = artery(
        systolic=f"{(low_mmhg + 40) * PASCALS_PER_MMHG} Pa",
        diastolic=f"{low_mmhg * PASCALS_PER_MMHG} Pa",
    )
    curve, random = PulseCurve(3.0), np.random.default_rng(1)
    for _ in range(5):
        for share in (0.6, 0.8, 1.0, 1.2):
            height_n = truth.height_n(share * truth.best_n)
            curve.observe(
                share * truth.best_n, 0.0, height_n * (1 + 0.02 * random.standard_normal())
            )
    for share in (0.5, 0.7, 0.9, 1.1, 1.24):
        force_n = share * truth.best_n
        assert curve.height(force_n) == pytest.approx(truth.height_n(force_n), rel=0.1), share
        # The pulse of another hold-down is felt as this one would give it, with its shape.
        for pressure_pa in (truth.mean_pa, truth.mean_pa + 2e3):
            seen_n = truth.pulse_n(pressure_pa, truth.best_n)
            pressure = curve.law.pressure(seen_n / curve.height(truth.best_n), truth.best_n)
            felt_n = curve.law.share(pressure, force_n) * curve.height(force_n)
            expected_n = truth.pulse_n(pressure_pa, force_n)
            assert felt_n == pytest.approx(expected_n, rel=0.12, abs=5e-3), share


def test_a_stiff_artery_under_a_smaller_probe_is_learnt() -> None:
    # Babbs (2012): 0.076 and 0.021 per mmHg; a probe of 0.7 cm².
    per_n = 1 / (0.7e-4 * PASCALS_PER_MMHG)
    truth = ArteryLaw(0.5, 0.56, 0.37, 0.076 * per_n, 0.021 * per_n)
    curve = PulseCurve(3.0)
    for _ in range(5):
        for force_n in (0.4, 0.55, 0.7, 0.85):
            curve.observe(force_n, 0.0, float(truth.heights(np.array([force_n]))[0]))
    for force_n in (0.35, 0.5, 0.65, 0.8, 0.9):
        expected_n = float(truth.heights(np.array([force_n]))[0])
        assert curve.height(force_n) == pytest.approx(expected_n, rel=0.1), force_n


@given(st.floats(-5, 5), st.floats(0, 3), st.floats(-0.15, 0.15))
def test_any_reading_gives_a_bounded_pressure(share: float, force_n: float, least: float) -> None:
    law = PulseCurve(3.0).law
    pressure = law.pressure(share, force_n, least)
    assert LOWEST <= pressure <= HIGHEST
    if law.share(1.0, force_n) > 0.1 and LOWEST < pressure < HIGHEST and share > 1e-3:
        assert law.share(pressure, force_n) == pytest.approx(share, rel=1e-3, abs=5e-2)


def test_a_change_of_the_wrist_is_learnt() -> None:
    curve = learnt(artery())
    for _ in range(30):
        curve.observe(0.9, -0.05, 0.3)
    assert curve.height(0.9) == pytest.approx(0.3, rel=0.1)


@given(st.lists(st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 3), max_size=20))
def test_no_beat_makes_the_curve_useless(beats: list[tuple[float, float, float]]) -> None:
    curve = PulseCurve(3.0)
    for beat in beats:
        curve.observe(*beat)
    for force_n in (0.0, 1.0, 3.0, 1e9, -1e9):
        assert 0 < curve.height(force_n) < math.inf
        assert math.isfinite(curve.foot(force_n))


@pytest.mark.parametrize("scale", [0.3, 1.0, 3.0])
def test_the_stiffening_law_is_found_without_the_point_of_first_touch(scale: float) -> None:
    truth, fit = StiffeningLaw(0.4, 1.5e-3).scaled(scale), StiffnessFit()
    random = np.random.default_rng(1)
    for force_n in np.concatenate([np.linspace(0.2, 1.8, 40), np.linspace(1.8, 0.2, 40)] * 3):
        depth_m = truth.depth_m(float(force_n)) + 5e-3
        fit.observe(float(force_n) + 2e-3 * float(random.standard_normal()), depth_m)
    for force_n in (0.4, 1.0, 1.6):
        expected = truth.stiffness_n_per_m(force_n)
        assert fit.law.stiffness_n_per_m(force_n) == pytest.approx(expected, rel=0.1)


@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 2), max_size=40))
def test_no_answer_makes_the_law_extreme(pairs: list[tuple[float, float]]) -> None:
    fit = StiffnessFit()
    for force_n, depth_m in pairs:
        fit.observe(force_n, depth_m)
    typical = StiffeningLaw()
    for force_n in (0.0, 1.0, 3.0):
        ratio = fit.law.stiffness_n_per_m(force_n) / typical.stiffness_n_per_m(force_n)
        assert 0.09 <= ratio <= 11


def test_noise_at_a_constant_press_teaches_nothing() -> None:
    fit, random = StiffnessFit(), np.random.default_rng(1)
    for _ in range(1000):
        noise_n = 0.02 * LEAST_CHANGE_N * float(random.standard_normal())
        fit.observe(1.0 + noise_n, 2e-3)
    assert fit.law == StiffeningLaw()


def test_a_beat_during_which_the_hold_down_moved_changes_a_steep_curve_less() -> None:
    truth = artery()
    changes = []
    for moved_n in (0.0, 0.04):
        curve = learnt(truth)
        before_n = curve.height(1.5)
        curve.observe(1.5, 0.0, 1.3 * before_n, moved_n)
        changes.append(curve.height(1.5) / before_n - 1)
    assert changes[0] > 1.5 * changes[1] > 0
