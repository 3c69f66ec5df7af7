import numpy as np
import pytest

from display_node.prediction.expert import HORIZONS
from display_node.prediction.path_errors import DELAYS, ExpectedErrors, PathErrors
from protocol.tactile import JND

# Half a beat in steps of 10 ms.
HALF = 50
# Steps of the last beat.
LAST = 100
HEIGHT = np.array([2.0])


def known(errors: PathErrors, channel: int = 0, scale: float = 1.0) -> ExpectedErrors:
    found = errors.expected(channel, scale, LAST)
    assert found is not None
    return found


def hold(errors: PathErrors, first: int, last: int) -> None:
    """Hold each value of a sine as the path after it."""
    for step in range(first, last):
        newest = np.array([np.sin(np.pi * step / HALF)])
        errors.add(newest, np.repeat(newest[:, np.newaxis], HORIZONS, axis=1), HEIGHT)


def be_wrong(
    errors: PathErrors, steps: int, by: float, one_in: int = 1, artefact: bool = False
) -> None:
    """Predict 0, and be wrong by so much at one step in some."""
    for step in range(steps):
        newest = np.array([by * (step % one_in == 0)])
        errors.add(newest, np.zeros((1, HORIZONS)), HEIGHT, artefact)


def test_no_error_is_known_before_every_horizon_was_judged() -> None:
    errors = PathErrors(1)
    hold(errors, 0, HORIZONS + DELAYS)
    assert errors.expected(0, 1.0, LAST) is None
    hold(errors, 0, 2 * HALF)
    assert np.isfinite(known(errors).in_phase_n2).all()


def test_a_force_that_is_held_and_felt_late_is_wrong_by_the_pulses_change_over_both_times() -> None:
    errors = PathErrors(1)
    hold(errors, 0, 40 * HALF)
    found, steps = known(errors), np.arange(HORIZONS + DELAYS)
    # Mean square change of a sine over so many steps.
    change = 1 - np.cos(np.pi * steps / HALF)
    for horizon in range(HORIZONS + 1):
        expected = change[horizon : horizon + DELAYS]
        np.testing.assert_allclose(found.in_phase_n2[horizon], expected, rtol=0.02, atol=1e-9)
    np.testing.assert_allclose(found.squares_n2, change[1 : HORIZONS + 1], rtol=0.1)
    assert known(errors, scale=3.0).in_phase_n2[4, 7] == 9 * found.in_phase_n2[4, 7]


@pytest.mark.parametrize(("over", "share"), [(1.01, 0.05), (0.99, 0.0)])
def test_an_error_is_noticed_above_the_jnd_for_as_long_as_it_lasts(
    over: float, share: float
) -> None:
    errors = PathErrors(1)
    be_wrong(errors, 4_000, over * JND * HEIGHT.item(), one_in=20)
    found = known(errors)
    assert found.noticed[0] == 0
    np.testing.assert_allclose(found.noticed[1:], share, atol=0.005)


def test_errors_of_the_first_seconds_are_soon_forgotten() -> None:
    errors = PathErrors(1)
    be_wrong(errors, 500, 1.0)
    assert known(errors).noticed[5] > 0.95
    be_wrong(errors, 2_000, 0.0)
    assert known(errors).noticed[5] < 0.01
    assert known(errors).in_phase_n2[5, 0] < 0.01


def test_a_single_event_is_no_rate_and_two_are() -> None:
    errors = PathErrors(1)
    be_wrong(errors, 6_000, 0.0)
    be_wrong(errors, 60, 1.0)
    be_wrong(errors, 140, 0.0)
    assert known(errors).noticed[5] == 0
    be_wrong(errors, 800, 0.0)
    be_wrong(errors, 60, 1.0)
    be_wrong(errors, 140, 0.0)
    # One of both, over the rest of the last third.
    assert known(errors).noticed[5] == pytest.approx(60 / (7_200 / 3 - 200), rel=0.1)


def test_an_artefact_counts_at_once_and_is_forgotten_within_5_s() -> None:
    errors = PathErrors(1)
    be_wrong(errors, 3_000, 0.0)
    be_wrong(errors, 100, 1.0, artefact=True)
    assert known(errors).noticed[5] > 0.5
    be_wrong(errors, 500, 0.0)
    assert known(errors).noticed[5] < 0.01
    # What was learnt of the pulse is unchanged.
    assert known(errors).in_phase_n2[5, 0] == pytest.approx(0, abs=0.01)


def test_channels_are_judged_by_their_own_height() -> None:
    errors, heights = PathErrors(2), np.array([2.0, 0.2])
    for step in range(2_000):
        newest = np.full(2, 0.1 * (step // 7 % 2))
        errors.add(newest, np.zeros((2, HORIZONS)), heights)
    wide, narrow = known(errors, 0), known(errors, 1)
    assert (wide.height_n, narrow.height_n) == (2.0, 0.2)
    assert wide.noticed.max() == 0
    assert narrow.noticed[1] == pytest.approx(0.5, abs=0.01)


def test_one_enormous_sample_leaves_later_estimates_right() -> None:
    errors = PathErrors(1)
    for value in (1.0, 1e20, np.nan):
        errors.add(np.array([value]), np.zeros((1, HORIZONS)), HEIGHT)
    for _ in range(6_000):
        errors.add(np.array([1.0]), np.zeros((1, HORIZONS)), HEIGHT)
    assert known(errors).squares_n2[3] == pytest.approx(1.0)
    assert known(errors).in_phase_n2[3, 0] == pytest.approx(1.0, rel=0.2)


@pytest.mark.parametrize("noise", [0.02, 0.06])
def test_white_noise_of_the_sensor_is_no_error_of_the_prediction(noise: float) -> None:
    """Of paths without an error, and of paths that are off by less than a finger notices."""
    rng, errors = np.random.default_rng(1), PathErrors(1)
    off = 0.9 * JND * HEIGHT.item()
    for step in range(6_000):
        path = np.zeros((1, HORIZONS))
        # Off at half of the horizons.
        path[:, HORIZONS // 2 :] = off * (-1) ** (step // 7)
        errors.add(noise * rng.standard_normal(1), path, HEIGHT)
    found = known(errors)
    assert found.in_phase_n2[5, 0] < 0.2 * noise**2
    assert found.in_phase_n2[20, 0] == pytest.approx(off**2, rel=0.05)
    assert found.noticed[5] < 0.01
