import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from display_node.press.artery_law import HIGHEST, LOWEST, ArteryLaw
from display_node.press.learnt_beats import BeatLevels
from display_node.press.tissue_model import PulseCurve, StiffnessFit
from protocol.tissue import PASCALS_PER_MMHG, StiffeningLaw
from sensing_node.sources.wrist import Artery, WristScene

# Pressures of foot, quartiles and peak of a modelled beat.
PRESSURES = (0.0, 0.12, 0.47, 0.63, 1.0)
VISITED_N = (0.5, 0.7, 0.9, 1.1, 1.3, 1.5)
BETWEEN_N = (0.6, 0.8, 1.0, 1.2, 1.4)


def artery(**keys: Any) -> Artery:
    return Artery(WristScene.model_validate({"kind": "wrist"} | keys), 0.27)


def artery_of_mean(mean_mmhg: int) -> Artery:
    low_mmhg = mean_mmhg - 0.27 * 40
    return artery(
        systolic=f"{(low_mmhg + 40) * PASCALS_PER_MMHG} Pa",
        diastolic=f"{low_mmhg * PASCALS_PER_MMHG} Pa",
    )


def foot_share(force_n: float) -> float:
    """Return the foot's level of a film whose zero is the mean of a pulse that flattens."""
    return -0.45 + 0.2 * force_n


def beat(
    levels_n: Sequence[float], force_n: float, number: int, moved_n: float = 0.0
) -> BeatLevels:
    foot_n, first_n, second_n, third_n, peak_n = map(float, levels_n)
    levels = foot_n, first_n, second_n, third_n, peak_n
    return BeatLevels(0.8 * number, 0.15, force_n, moved_n, levels)


def levels_n(truth: Artery | ArteryLaw, force_n: float, breath: float = 0.0) -> list[float]:
    """Return the film's levels of a beat, above diastole."""
    found = []
    for pressure in PRESSURES:
        if isinstance(truth, ArteryLaw):
            height_n = float(truth.heights(np.array([force_n]))[0])
            found.append(truth.share(pressure + breath, force_n) * height_n)
        else:
            pulse_pa = (truth.mean_pa - truth.diastolic_pa) / 0.27
            pressure_pa = truth.diastolic_pa + (pressure + breath) * pulse_pa
            found.append(truth.pulse_n(pressure_pa, force_n))
    return found


def learnt(
    truth: Artery | ArteryLaw,
    visited_n: Sequence[float] = VISITED_N,
    noise: float = 0.02,
    breath: float = 0.0,
    foot: Callable[[float], float] = lambda force_n: 0.0,
) -> PulseCurve:
    """Learn five beats at each force, with noise of the height and a respiratory wave."""
    curve, random = PulseCurve(3.0), np.random.default_rng(1)
    for number in range(5 * len(visited_n)):
        force_n = visited_n[number // 5]
        wave = breath * math.sin(1.5 * 0.8 * number)
        gain = 1 + noise * random.standard_normal()
        above_n = gain * np.array(levels_n(truth, force_n, wave))
        level_n = foot(force_n) * float(above_n[-1] - above_n[0])
        curve.observe(beat(above_n + level_n, force_n, number))
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
    curve = learnt(truth, foot=foot_share)
    for force_n in (*VISITED_N, *BETWEEN_N):
        assert curve.height(force_n) == pytest.approx(truth.height_n(force_n), rel=0.1), force_n
        assert curve.foot(force_n) == pytest.approx(foot_share(force_n), abs=0.05)
    assert curve.beats == 30


@pytest.mark.parametrize("mean_mmhg", [70, 100, 130])
def test_forces_never_visited_are_predicted_by_the_law_of_any_wrist(mean_mmhg: int) -> None:
    truth = artery_of_mean(mean_mmhg)
    curve = learnt(truth, [share * truth.best_n for share in (0.6, 0.8, 1.0, 1.2)])
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


@pytest.mark.parametrize("mean_mmhg", [70, 130])
def test_respiration_does_not_spoil_what_is_learnt(mean_mmhg: int) -> None:
    """Three of ten visits are near the closed artery, whose height respiration changes by 40 %."""
    truth = artery_of_mean(mean_mmhg)
    visited_n = [share * truth.best_n for share in np.linspace(0.45, 1.35, 10).tolist()]
    curve = learnt(truth, visited_n, noise=0.005, breath=0.08)
    for force_n in visited_n:
        assert curve.height(force_n) == pytest.approx(truth.height_n(force_n), rel=0.06), force_n


def test_far_beyond_a_closed_artery_the_expected_diastole_is_assumed() -> None:
    law = PulseCurve(3.0).law
    assert law.pressure(0.5, 9e5, 0.05) == 0.05


@given(st.floats(-5, 5), st.floats(0, 3), st.floats(-0.15, 0.15))
def test_any_reading_gives_a_bounded_pressure(share: float, force_n: float, least: float) -> None:
    law = PulseCurve(3.0).law
    pressure = law.pressure(share, force_n, least)
    assert LOWEST <= pressure <= HIGHEST
    if law.share(1.0, force_n) > 0.1 and LOWEST < pressure < HIGHEST and share > 1e-3:
        assert law.share(pressure, force_n) == pytest.approx(share, rel=1e-3, abs=5e-2)


@given(st.lists(st.tuples(*[st.floats(allow_nan=True, allow_infinity=True)] * 9), max_size=20))
@example([(0.0, 0.0, 0.0, 0.0, 0.0, math.nan, 0.0, 0.0, 1.0)])
@example([(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.nan, 1.0)])
def test_no_beat_makes_the_curve_useless(beats: list[tuple[float, ...]]) -> None:
    curve = PulseCurve(3.0)
    for at_s, rise_s, force_n, moved_n, *levels in beats:
        foot_n, first_n, second_n, third_n, peak_n = levels
        each = foot_n, first_n, second_n, third_n, peak_n
        curve.observe(BeatLevels(at_s, rise_s, force_n, moved_n, each))
    for force_n in (0.0, 1.0, 3.0, 1e9, -1e9):
        assert 0 < curve.height(force_n) < math.inf
        assert math.isfinite(curve.foot(force_n))


@pytest.mark.parametrize("scale", [0.3, 1.0, 3.0])
def test_the_stiffening_law_is_found_without_the_point_of_first_touch(scale: float) -> None:
    truth, fit = StiffeningLaw(0.4, 1.5e-3 / scale), StiffnessFit()
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
