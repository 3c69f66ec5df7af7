import math

import numpy as np
import pytest

from display_node.prediction.path_errors import BLENDED, DELAYS, ExpectedErrors
from display_node.prediction.trust import HORIZONS, DelayChoice, PulseSize, Trust

MS = 1_000_000
REQUIRED_NS = 62 * MS
HEIGHT_N = 0.3
# Error in phase of a pulse that is felt 10 ms late, over its height, and how it grows.
LATE = 0.04


def errors(*shares: float, noticed: tuple[float, ...] = (0.0,)) -> ExpectedErrors:
    """Return RMS errors of the prediction: shares of the height at 10, 20 … ms.

    noticed: share of the time, at these horizons. The last of each holds further on.
    """
    known = [*shares, *shares[-1:] * (HORIZONS - len(shares))]
    over = np.array([0.0, *noticed, *noticed[-1:] * (HORIZONS - len(noticed))])
    squares_n2 = HEIGHT_N**2 * np.square(known)
    late_n2 = (HEIGHT_N * LATE * np.arange(DELAYS)) ** 2
    in_phase_n2 = np.concatenate([[0.0], squares_n2])[:, np.newaxis] + late_n2
    return ExpectedErrors(squares_n2, in_phase_n2, over, HEIGHT_N)


def chosen_ms(
    trust: Trust,
    from_ms: int,
    to_ms: int,
    expected: ExpectedErrors | None,
    *ages_ms: float,
    required_ns: int = REQUIRED_NS,
) -> list[float]:
    """Return E in ms at each tick; the ages repeat, each for 5 ms."""
    found = []
    for at_ms in range(from_ms, to_ms):
        age_ms = ages_ms[at_ms // 5 % len(ages_ms)]
        found.append(trust.observe(at_ms * MS, round(age_ms * MS), required_ns) / MS)
        if trust.due:
            trust.choose([expected])
    return found


def test_e_is_the_required_delay_while_no_error_is_known() -> None:
    trust = Trust()
    assert set(chosen_ms(trust, 0, 3000, None, 55)) == {62}
    assert not trust.given


@pytest.mark.parametrize("error", [0.002, 0.05, 0.2])
def test_e_is_0_where_no_error_is_noticed_and_lateness_costs_more(error: float) -> None:
    trust = Trust()
    assert chosen_ms(trust, 0, 3000, errors(error), 57)[-1] == 0
    assert trust.given


def test_e_leaves_the_horizon_to_the_predictor_that_costs_least() -> None:
    # 40 ms ahead the prediction is worse than the pulse of 40 ms ago.
    steep = errors(0.0, 0.0, 0.0, 0.3)
    assert chosen_ms(Trust(), 0, 3000, steep, 57)[-1] == 40


@pytest.mark.parametrize(("target", "wanted_ms"), [(0.005, 55), (0.025, 35), (0.2, 0)])
def test_e_leaves_the_horizon_at_which_an_error_is_noticed_seldom_enough(
    target: float, wanted_ms: int
) -> None:
    expected = errors(0.01, noticed=(0.01, 0.01, 0.02, 0.05, 0.06, 0.06, 0.1))
    found = chosen_ms(Trust("auto", target), 0, 3000, expected, 57)
    assert found[-1] == pytest.approx(wanted_ms, abs=1)


def test_where_errors_are_noticed_at_every_e_what_a_smaller_one_adds_decides() -> None:
    # One sample in ten is later than any E that the link requires.
    ages_ms = [40.0] * 9 + [180.0]
    expected = errors(0.1, noticed=(0.5,))
    assert chosen_ms(Trust(), 0, 5000, expected, *ages_ms)[-1] == pytest.approx(48, abs=1)
    # The same without a limit.
    assert chosen_ms(Trust("auto", 0.5), 0, 5000, expected, *ages_ms)[-1] == 0


def test_what_is_felt_was_predicted_earlier_by_the_time_of_the_blend() -> None:
    # With 50 ms between sample and E = 0, a path of 60 ms ahead is felt.
    horizon = round(BLENDED * 5)
    late = errors(0.01, noticed=(*[0.0] * (horizon - 1), 0.5))
    assert chosen_ms(Trust(), 0, 3000, late, 50 - 2.5)[-1] == pytest.approx(10, abs=0.5)
    later = errors(0.01, noticed=(*[0.0] * horizon, 0.5))
    assert chosen_ms(Trust(), 0, 3000, later, 50 - 2.5)[-1] == 0


def test_of_several_contactors_the_one_that_notices_most_decides() -> None:
    trust = Trust()
    calm, rough = errors(0.01), errors(0.01, noticed=(0.0, 0.0, 0.5))
    for at_ms in range(1000):
        e_ns = trust.observe(at_ms * MS, 57 * MS, REQUIRED_NS)
        if trust.due:
            trust.choose([calm, rough])
    assert e_ns / MS == pytest.approx(49, abs=1)


def test_a_delay_beyond_the_prediction_is_buffered_as_far_as_nothing_is_predicted() -> None:
    # 250 ms are predicted; what is felt of them reaches over a fifth less.
    found = chosen_ms(Trust(), 0, 3000, errors(0.01), 400, required_ns=420 * MS)
    assert found[-1] == pytest.approx(206, abs=1)


def test_a_silence_which_no_e_covers_hardly_changes_e() -> None:
    trust, expected = Trust(), errors(0.01)
    assert chosen_ms(trust, 0, 3000, expected, 57)[-1] == 0
    silent = [chosen_ms(trust, at, at + 1, expected, at - 2943)[0] for at in range(3000, 4000)]
    assert max(silent) <= 10


def test_expected_shares_are_corrected_by_those_that_are_felt() -> None:
    """Towards half as much, and twice as much, of what is expected."""
    expected = errors(0.01, noticed=(0.01, 0.01, 0.02, 0.03, 0.05, 0.06, 0.1))
    chosen = {}
    for felt in (0.0, 0.02, 0.1):
        trust = Trust("auto", 0.02)
        for at_ms in range(20_000):
            e_ns = trust.observe(at_ms * MS, 57 * MS, REQUIRED_NS)
            if trust.due:
                trust.choose([expected], felt)
        chosen[felt] = e_ns / MS
    assert chosen[0.0] < chosen[0.02] - 3 < chosen[0.1] - 4


@pytest.mark.parametrize("choice", ["auto", "shape"])
def test_a_pulse_without_a_height_and_samples_without_an_age_are_no_error(
    choice: DelayChoice,
) -> None:
    zero = ExpectedErrors(
        np.zeros(HORIZONS), np.zeros((HORIZONS + 1, DELAYS)), np.zeros(HORIZONS + 1), 0.0
    )
    for age_ms in (-10, 0, 57):
        trust = Trust(choice)
        assert chosen_ms(trust, 0, 7000, zero, age_ms)[-1] == 0
        # After a pause of the display.
        assert chosen_ms(trust, 20_000, 21_000, zero, age_ms)[-1] == 0


def test_e_is_reduced_by_400_ms_at_most() -> None:
    """Above 0.5 s the playout would jump."""
    found = chosen_ms(Trust(), 0, 3000, errors(0.0), 30, required_ns=450 * MS)
    assert found[0] == 450
    assert found[-1] == 50


def shape_ms(trust: Trust, from_ms: int, to_ms: int, *shares: float) -> list[float]:
    """Return E with samples of 57 ms, from which 12 % are taken for the blend."""
    return chosen_ms(trust, from_ms, to_ms, errors(*shares), 57)


@pytest.mark.parametrize("error", [0.05, math.inf])
def test_the_shape_needs_the_required_delay_without_a_small_error(error: float) -> None:
    trust = Trust("shape")
    assert set(shape_ms(trust, 0, 5000, error)) == {62}
    assert not trust.given


def test_the_shape_leaves_the_horizon_to_the_predictor_at_which_its_error_is_small() -> None:
    # 1.1 % of the height 30 ms ahead, 1.3 % at 40 ms. Samples are 57 ms old: 27 ms are predicted.
    assert shape_ms(Trust("shape"), 0, 3000, 0.002, 0.006, 0.011, 0.013, 0.2)[-1] == 30


def test_for_the_shape_e_falls_after_a_second_of_small_errors_and_rises_at_once() -> None:
    trust = Trust("shape")
    shape_ms(trust, 0, 2000, 0.013)
    falling = shape_ms(trust, 2000, 4000, 0.01)
    assert falling.index(0) == pytest.approx(1000, abs=60)
    assert set(falling[:940]) == {62}
    # Between both bounds it stays.
    assert set(shape_ms(trust, 4000, 9000, 0.014)) == {0}
    risen = shape_ms(trust, 9000, 9100, 0.025)
    assert risen[60:] == [62] * 40


def test_an_error_in_each_beat_prevents_that_e_falls_for_the_shape() -> None:
    trust = Trust("shape")
    for beat_ms in range(0, 9600, 800):
        calm = shape_ms(trust, beat_ms, beat_ms + 700, 0.005)
        onset = shape_ms(trust, beat_ms + 700, beat_ms + 800, 0.015)
        assert set(calm + onset) == {62}


def observe(size: PulseSize, from_s: float, to_s: float, offset_n: float = 0.0) -> None:
    """Add a sine of 1.2 Hz, 0.3 N from foot to peak."""
    for first_ms in range(round(from_s * 1000), round(to_s * 1000), 5):
        wave = [math.sin(2 * math.pi * 1.2e-3 * (first_ms + ms)) for ms in range(5)]
        size.observe(first_ms * MS, [0.15 * value + offset_n for value in wave])


def test_the_pulses_size_is_known_after_a_window_ignores_an_artefact_and_follows_a_change() -> None:
    size = PulseSize()
    observe(size, 0, 2)
    assert size.size is None
    observe(size, 2, 2.1)
    assert size.size == pytest.approx(0.3, rel=1e-3)
    observe(size, 2.1, 11)
    observe(size, 11, 13, offset_n=2.0)
    for from_s, to_s in ((13, 14.1), (14.1, 20)):
        observe(size, from_s, to_s)
        assert size.size == pytest.approx(0.3, rel=1e-3)
    for first_ms in range(20_000, 40_000, 5):
        size.observe(first_ms * MS, [0.1 * (first_ms % 1000 < 500)])
    assert size.size == pytest.approx(0.1)
