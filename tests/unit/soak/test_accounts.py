from dataclasses import replace

import pytest

from soak.accounts import Mark, Session, reckon

S, MS = 1_000_000_000, 1_000_000
FIRST = Session(began_ns=0, ended_ns=10 * S, period_ns=MS, least=10_000, most=10_000)
# Killed at 30 s: how much it had sent by then is not known to the sample.
KILLED = Session(began_ns=20 * S, ended_ns=30 * S, period_ns=MS, least=9_990, most=10_005)
LAST = Session(began_ns=32 * S, ended_ns=40 * S, period_ns=MS, least=8_000, most=8_000)
KILL = (30 * S, 32 * S)


def marks(*rows: tuple[float, str, int]) -> list[Mark]:
    return [Mark(round(at_s * S), state, total) for at_s, state, total in rows]


REPORTED = marks((5, "playing", 4_900), (10.3, "ended", 10_000), (15, "ended", 10_000))


def test_a_session_whose_end_was_reported_is_accounted_for_to_the_sample() -> None:
    (found,) = reckon(REPORTED, [FIRST], [])
    assert (found.counted, found.exact, found.off) == (10_000, True, 0)


@pytest.mark.parametrize(("total", "off"), [(9_999, 1), (10_001, -1), (1, 9_999)])
def test_one_sample_more_or_less_is_noticed(total: int, off: int) -> None:
    (found,) = reckon([REPORTED[0], Mark(11 * S, "ended", total)], [FIRST], [])
    assert found.off == off


def test_it_may_say_that_it_ended_before_all_was_played() -> None:
    early = [Mark(10 * S + MS, "ended", 9_950), *REPORTED[1:]]
    (found,) = reckon([REPORTED[0], *early], [FIRST], [])
    assert found.off == 0


def killed(total: int) -> list[Mark]:
    return [
        *REPORTED,
        *marks((29, "playing", 18_900), (31.9, "stale", total), (33, "starting", total)),
    ]


def test_a_killed_sessions_tail_may_be_missing_and_nothing_before_it() -> None:
    for total, off in ((20_005, 0), (19_000, 0), (18_999, 1), (20_006, -1)):
        exact, open_end = reckon(killed(total), [FIRST, KILLED], [KILL])
        assert exact.off == 0
        assert not open_end.exact
        assert open_end.off == off


def test_without_a_fault_there_is_no_excuse_for_a_missing_tail() -> None:
    _, open_end = reckon(killed(19_000), [FIRST, KILLED], [])
    assert open_end.off == 0
    _, open_end = reckon(killed(18_500), [FIRST, KILLED], [])
    assert open_end.off == 500


def test_after_a_killed_session_the_next_reported_end_sums_up_both() -> None:
    rows = [*killed(20_000), *marks((41, "ended", 28_000))]
    _, both = reckon(rows, [FIRST, KILLED, LAST], [KILL])
    assert (both.counted, both.off) == (18_000, 0)
    rows = [*killed(20_000), *marks((41, "ended", 26_900))]
    _, both = reckon(rows, [FIRST, KILLED, LAST], [KILL])
    assert both.off == 100


def test_faults_close_to_each_other_excuse_what_began_with_the_first() -> None:
    cut = (25 * S, 28 * S)
    _, open_end = reckon(killed(14_000), [FIRST, KILLED], [cut, KILL])
    assert open_end.off == 0
    _, open_end = reckon(killed(13_999), [FIRST, KILLED], [cut, KILL])
    assert open_end.off == 1
    _, open_end = reckon(killed(14_000), [FIRST, KILLED], [(20 * S, 21 * S), KILL])
    assert open_end.off == 5_000


def test_a_display_that_left_has_counted_what_came_until_then() -> None:
    left = replace(LAST, ended_ns=60 * S, least=28_000, most=28_000)
    rows = marks((45, "playing", 12_900))
    (found,) = reckon(rows, [left], [])
    assert (found.off, found.exact) == (0, False)
    (found,) = reckon(marks((45, "playing", 11_900)), [left], [])
    assert found.off == 100
    # What the session sent later is no excuse for more.
    (found,) = reckon(marks((45, "playing", 13_001)), [left], [])
    assert found.off == 0
    (found,) = reckon(marks((45, "playing", 13_002)), [left], [])
    assert found.off == -1


def test_one_that_never_joined_has_nothing_to_account_for() -> None:
    assert reckon([], [FIRST], []) == []
    assert reckon(marks((5, "waiting", 0)), [FIRST], []) == []


def test_a_session_that_was_over_before_it_joined_may_count_or_not() -> None:
    for total in (0, 10_000):
        rows = marks(
            (29.9, "waiting", 0), (33, "starting", total + 500), (41, "ended", total + 8_000)
        )
        (found,) = reckon(rows, [KILLED, LAST], [])
        assert found.off == 0
    (found,) = reckon(marks((29.9, "playing", 1), (41, "ended", 8_000)), [KILLED, LAST], [])
    assert found.off == 9_000
