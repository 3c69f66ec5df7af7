"""The curve of the pulse against the hold-down: its best force, levels, and what disturbs it."""

import numpy as np
import pytest

from display_node.scoring.depth_curve import BeatPoint, DepthCurve, fit_depth_curve
from protocol.errors import DepthError


def point(force_n: float, height_n: float, quality: float = 1.0) -> BeatPoint:
    return BeatPoint(force_n, height_n, 0.3, 0.13, 0.4, 0.3, quality)


def swept(height: "np.ufunc | object", error: float = 0.01, beats: int = 5) -> list[BeatPoint]:
    """Return beats at forces of 0.2 to 2.2 N, with errors of their height."""
    rng = np.random.default_rng(3)
    forces = np.repeat(np.linspace(0.2, 2.2, 11), beats)
    heights = np.array([height(force) for force in forces])
    heights *= 1 + error * rng.standard_normal(len(forces))
    return [point(*each) for each in zip(forces.tolist(), heights.tolist(), strict=True)]


def bell(force_n: float) -> float:
    return 0.3 * float(np.exp(-0.5 * ((force_n - 1.2) / 0.4) ** 2))


def plateau(force_n: float) -> float:
    return 0.3 * min(1.0, force_n / 0.8, max(0.0, (2.4 - force_n) / 0.8))


def test_best_force_and_levels_are_shares_of_the_curve() -> None:
    curve = fit_depth_curve(swept(bell))
    half_n = 0.4 * float(np.sqrt(2 * np.log(2)))
    assert curve.light_n is not None
    assert curve.deepest_n is not None
    assert curve.best_n.value == pytest.approx(1.2, rel=0.03)
    assert curve.light_n.value == pytest.approx(1.2 - half_n, rel=0.03)
    assert curve.deepest_n.value == pytest.approx(1.2 + half_n, rel=0.03)
    assert curve.largest_n.value == pytest.approx(0.3, rel=0.02)
    assert curve.at_end is None


def test_where_the_curve_is_flat_the_best_force_is_the_lower_one() -> None:
    best_n = fit_depth_curve(swept(plateau, error=0.001)).best_n.value
    assert 0.7 < best_n < 1.0


def test_artefacts_change_the_curve_little() -> None:
    clean = swept(bell)
    disturbed = [
        each._replace(height_n=2.5 * each.height_n) if number % 7 == 3 else each
        for number, each in enumerate(clean)
    ]
    before, after = fit_depth_curve(clean), fit_depth_curve(disturbed)
    assert after.best_n.value == pytest.approx(before.best_n.value, rel=0.03)
    assert after.largest_n.value == pytest.approx(before.largest_n.value, rel=0.05)


def test_doubtful_beats_are_not_used() -> None:
    doubtful = [point(0.3, 3.0, quality=0.2) for _ in range(40)]
    curve = fit_depth_curve([*swept(bell), *doubtful])
    assert curve.largest_n.value == pytest.approx(0.3, rel=0.02)
    assert len(curve.good) == 55


def test_levels_that_were_not_reached_are_missing_and_an_end_is_named() -> None:
    curve: DepthCurve = fit_depth_curve([each for each in swept(bell) if each.hold_down_n < 1.1])
    assert curve.deepest_n is None
    assert curve.light_n is not None
    assert curve.at_end is not None
    assert "press harder" in curve.at_end


@pytest.mark.parametrize("beats", [[], swept(bell)[:11], [point(1.0, 0.3)] * 50])
def test_too_few_beats_are_refused_with_what_to_do(beats: list[BeatPoint]) -> None:
    with pytest.raises(DepthError, match=r"too few beats for a curve: \d+ good of \d+, .* wider"):
        fit_depth_curve(beats)
