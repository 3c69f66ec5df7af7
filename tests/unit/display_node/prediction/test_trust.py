import math

import pytest

from display_node.prediction.concealment import MOST_NS, PulseSize, Trust, auto_delay_ns

MS = 1_000_000
SECOND_NS = 1_000 * MS
TICK_NS = 5 * MS


def judged(trust: Trust, from_s: float, to_s: float, error_n: float | None) -> list[bool]:
    """Whether it is trusted after each tick, for a pulse of 0.3 N."""
    said = []
    for now_ns in range(round(from_s * SECOND_NS), round(to_s * SECOND_NS), TICK_NS):
        trust.judge(now_ns, error_n, 0.3)
        said.append(trust.trusted)
    return said


def test_trust_is_won_slowly_and_lost_at_once() -> None:
    trust = Trust()
    assert not any(judged(trust, 0, 15, 0.003))
    assert judged(trust, 15, 20, 0.003)[-1]
    # A prediction that is off by a third of the pulse.
    lost = judged(trust, 20, 20.5, 0.1)
    assert lost.index(False) * TICK_NS <= 50 * MS
    assert not any(lost[lost.index(False) :])
    assert not any(judged(trust, 20.5, 30.5, 0.003))
    assert judged(trust, 30.5, 37, 0.003)[-1]


@pytest.mark.parametrize("error_n", [None, 0.0085, math.inf])
def test_what_is_unknown_or_large_is_never_trusted(error_n: float | None) -> None:
    assert not any(judged(Trust(), 0, 60, error_n))


def test_between_the_two_bounds_nothing_changes() -> None:
    stranger, friend = Trust(), Trust()
    judged(friend, 0, 20, 0.003)
    assert not any(judged(stranger, 20, 60, 0.0105))
    assert all(judged(friend, 20, 60, 0.0105))


def test_a_silence_counts_for_as_long_as_it_lasts() -> None:
    trust = Trust()
    judged(trust, 0, 20, 0.003)
    # Further ahead than is predicted, no error is known.
    trust.judge(21 * SECOND_NS, None, 0.3)
    assert not trust.trusted


@pytest.mark.parametrize(("stall_ms", "trusted"), [(20, True), (60, False)])
def test_it_matters_for_how_long_an_error_would_be_felt(stall_ms: int, trusted: bool) -> None:
    trust = Trust()
    for now_ms in range(0, 40_000, 5):
        # A tenth of the pulse, twice a second.
        trust.judge(now_ms * MS, 0.03 if now_ms % 500 < stall_ms else 0.0, 0.3)
    assert trust.trusted is trusted


def test_without_a_pulse_there_is_no_trust() -> None:
    trust = Trust()
    for now_ns in range(0, 60 * SECOND_NS, TICK_NS):
        trust.judge(now_ns, 0.0, 0.0)
    assert not trust.trusted


def observe(size: PulseSize, from_s: float, to_s: float, offset_n: float = 0.0) -> None:
    """A sine of 0.3 N from foot to peak, 1.2 times a second."""
    for first_ms in range(round(from_s * 1000), round(to_s * 1000), 5):
        wave = [math.sin(2 * math.pi * 1.2e-3 * (first_ms + ms)) for ms in range(5)]
        size.observe(first_ms * MS, [0.15 * value + offset_n for value in wave])


def test_the_pulses_size_is_known_after_a_window() -> None:
    size = PulseSize()
    observe(size, 0, 2)
    assert size.size is None
    observe(size, 2, 2.1)
    assert size.size == pytest.approx(0.3, rel=1e-3)


def test_a_jump_of_the_hand_does_not_make_the_pulse_larger() -> None:
    size = PulseSize()
    observe(size, 0, 11)
    observe(size, 11, 13, offset_n=2.0)
    observe(size, 13, 20)
    assert size.size == pytest.approx(0.3, rel=1e-3)


def test_a_pulse_that_has_changed_is_measured_anew() -> None:
    size = PulseSize()
    observe(size, 0, 20)
    for first_ms in range(20_000, 40_000, 5):
        size.observe(first_ms * MS, [0.1 * (first_ms % 1000 < 500)])
    assert size.size == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("carried_ms", "trusted", "wanted_ms"),
    [(60, False, 60), (60, True, 0), (0, True, 0), (450, True, 50), (450, False, 450)],
)
def test_trust_takes_off_no_more_than_what_is_slewed(
    carried_ms: int, trusted: bool, wanted_ms: int
) -> None:
    assert auto_delay_ns(carried_ms * MS, trusted) == wanted_ms * MS
    assert MOST_NS < 500 * MS
