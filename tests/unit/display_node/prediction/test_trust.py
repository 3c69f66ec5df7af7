import math

import pytest

from display_node.prediction.trust import HORIZONS, PulseSize, Trust

MS = 1_000_000
REQUIRED_NS = 62 * MS


def errors(*shares: float) -> list[float]:
    """Return squared errors: shares of the height at 10, 20 … ms; the last one further on."""
    shares += shares[-1:] * (HORIZONS - len(shares))
    return [share**2 for share in shares]


def chosen_ms(
    trust: Trust,
    from_ms: int,
    to_ms: int,
    shares: list[float],
    *ages_ms: float,
    required_ns: int = REQUIRED_NS,
) -> list[float]:
    """Return E in ms after each tick; the ages repeat, each for 5 ms."""
    found = []
    for at_ms in range(from_ms, to_ms):
        age_ms = ages_ms[at_ms // 5 % len(ages_ms)]
        if trust.observe(at_ms * MS, round(age_ms * MS)):
            trust.evaluate(at_ms * MS, required_ns, shares)
        found.append(trust.delay_ns(required_ns) / MS)
    return found


@pytest.mark.parametrize("shares", [[], errors(0.05), errors(math.inf)])
@pytest.mark.parametrize("age_ms", [55, 700])
def test_e_is_the_required_delay_without_a_small_known_error(
    shares: list[float], age_ms: int
) -> None:
    trust = Trust()
    assert set(chosen_ms(trust, 0, 5000, shares, age_ms)) == {62}
    assert not trust.given


def test_e_falls_to_0_where_the_error_at_the_whole_age_is_small() -> None:
    trust = Trust()
    found = chosen_ms(trust, 0, 3000, errors(0.0, 0.002, 0.004, 0.007, 0.01, 0.0115), 57)
    assert found[-1] == 0
    assert trust.given


def test_e_leaves_the_horizon_to_the_predictor_at_which_its_error_is_small() -> None:
    # 1.1 % of the height 30 ms ahead, 1.3 % at 40 ms. Samples are 57 ms old: 27 ms are predicted.
    assert chosen_ms(Trust(), 0, 3000, errors(0.002, 0.006, 0.011, 0.013, 0.2), 57)[-1] == 30


def test_e_falls_after_a_second_of_small_errors_and_rises_at_once() -> None:
    trust = Trust()
    chosen_ms(trust, 0, 2000, errors(0.013), 57)
    falling = chosen_ms(trust, 2000, 4000, errors(0.01), 57)
    assert falling.index(0) == pytest.approx(1000, abs=20)
    assert set(falling[:980]) == {62}
    # Between both bounds it stays.
    assert set(chosen_ms(trust, 4000, 9000, errors(0.014), 57)) == {0}
    risen = chosen_ms(trust, 9000, 9100, errors(0.025), 57)
    assert risen[15:] == [62] * 85


def test_an_error_in_each_beat_prevents_that_e_falls() -> None:
    trust = Trust()
    for beat_ms in range(0, 9600, 800):
        calm = chosen_ms(trust, beat_ms, beat_ms + 700, errors(0.005), 57)
        onset = chosen_ms(trust, beat_ms + 700, beat_ms + 800, errors(0.015), 57)
        assert set(calm + onset) == {62}


@pytest.mark.parametrize(("stalled", "wanted_ms"), [(1, 0), (12, 62)])
def test_a_long_age_counts_for_as_long_as_it_lasts(stalled: int, wanted_ms: int) -> None:
    """A horizon of 150 ms has an error of 4 %: it may last for a tenth of the time."""
    ages_ms = [57.0] * (100 - stalled) + [157.0] * stalled
    shares = errors(*[0.005] * 10, 0.04)
    assert chosen_ms(Trust(), 0, 8000, shares, *ages_ms)[-1] == wanted_ms


def test_a_silence_beyond_the_prediction_ends_the_trust() -> None:
    trust = Trust()
    assert chosen_ms(trust, 0, 3000, errors(0.01), 57)[-1] == 0
    silent = [chosen_ms(trust, at, at + 1, errors(0.01), at - 2943)[0] for at in range(3000, 3400)]
    assert 250 - 57 < silent.index(62) < 300
    assert not trust.given


def test_e_is_reduced_by_400_ms_at_most() -> None:
    """Above 0.5 s the playout would jump."""
    found = chosen_ms(Trust(), 0, 3000, errors(0.0), 30, required_ns=450 * MS)
    assert found[0] == 450
    assert found[-1] == 50


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
