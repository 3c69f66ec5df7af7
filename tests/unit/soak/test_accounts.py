import pytest

from soak.accounts import Mark, Session, reckon, unaccounted

S, MS = 1_000_000_000, 1_000_000
FIRST = Session(began_ns=0, ended_ns=10 * S, period_ns=MS, least=10_000, most=10_000)
# Killed at 30 s: the number of samples sent by then is not known exactly.
KILLED = Session(began_ns=20 * S, ended_ns=30 * S, period_ns=MS, least=9_990, most=10_005)
LAST = Session(began_ns=32 * S, ended_ns=40 * S, period_ns=MS, least=8_000, most=8_000)
LONG = Session(began_ns=32 * S, ended_ns=60 * S, period_ns=MS, least=28_000, most=28_000)
KILL = (30 * S, 32 * S)


def marks(*rows: tuple[float, str, int]) -> list[Mark]:
    return [Mark(round(at_s * S), state, total) for at_s, state, total in rows]


PLAYED = (5, "playing", 4_900)
REPORTED = (PLAYED, (10.3, "ended", 10_000), (15, "ended", 10_000))


def killed(total: int) -> tuple[tuple[float, str, int], ...]:
    return (*REPORTED, (29, "playing", 18_900), (31.9, "stale", total), (33, "starting", total))


@pytest.mark.parametrize(
    ("rows", "off"),
    [
        (REPORTED, 0),
        ((PLAYED, (11, "ended", 9_999)), 1),
        ((PLAYED, (11, "ended", 10_001)), -1),
        ((PLAYED, (11, "ended", 1)), 9_999),
        # It may report its end before all samples are played.
        ((PLAYED, (10.001, "ended", 9_950), *REPORTED[1:]), 0),
    ],
)
def test_a_session_whose_end_was_reported_is_accounted_for_to_the_sample(
    rows: tuple[tuple[float, str, int], ...], off: int
) -> None:
    (found,) = reckon(marks(*rows), [FIRST], [])
    assert (found.exact, found.off) == (True, off)


@pytest.mark.parametrize(
    ("total", "faults", "off"),
    [
        (20_005, [KILL], 0),
        (19_000, [KILL], 0),
        (18_999, [KILL], 1),
        (20_006, [KILL], -1),
        # Without a fault only samples in transit may be missing.
        (19_000, [], 0),
        (18_500, [], 500),
        # A fault shortly after another excuses what began with the first.
        (14_000, [(25 * S, 28 * S), KILL], 0),
        (13_999, [(25 * S, 28 * S), KILL], 1),
        (14_000, [(20 * S, 21 * S), KILL], 5_000),
    ],
)
def test_only_the_tail_of_a_killed_session_may_be_missing(
    total: int, faults: list[tuple[int, int]], off: int
) -> None:
    exact, open_end = reckon(marks(*killed(total)), [FIRST, KILLED], faults)
    assert exact.off == 0
    assert (open_end.exact, open_end.off) == (False, off)


@pytest.mark.parametrize(("total", "counted", "off"), [(28_000, 18_000, 0), (26_900, 16_900, 100)])
def test_after_a_killed_session_the_next_end_sums_up_both(
    total: int, counted: int, off: int
) -> None:
    rows = marks(*killed(20_000), (41, "ended", total))
    _, both = reckon(rows, [FIRST, KILLED, LAST], [KILL])
    assert (both.counted, both.off) == (counted, off)


@pytest.mark.parametrize(
    # The samples that the session sent later do not excuse more.
    ("total", "off"),
    [(12_900, 0), (11_900, 100), (13_001, 0), (13_002, -1)],
)
def test_a_display_that_left_has_counted_what_arrived_until_then(total: int, off: int) -> None:
    (found,) = reckon(marks((45, "playing", total)), [LONG], [])
    assert (found.exact, found.off) == (False, off)


def test_a_display_that_never_joined_has_nothing_to_account_for() -> None:
    assert reckon([], [FIRST], []) == []
    assert reckon(marks((5, "waiting", 0)), [FIRST], []) == []


@pytest.mark.parametrize(
    ("rows", "off"),
    [
        (((29.9, "waiting", 0), (33, "starting", 500), (41, "ended", 8_000)), 0),
        (((29.9, "waiting", 0), (33, "starting", 10_500), (41, "ended", 18_000)), 0),
        (((29.9, "playing", 1), (41, "ended", 8_000)), 9_000),
    ],
)
def test_a_session_that_was_over_before_the_display_joined_may_count_or_not(
    rows: tuple[tuple[float, str, int], ...], off: int
) -> None:
    (found,) = reckon(marks(*rows), [KILLED, LAST], [])
    assert found.off == off


def test_set_points_that_do_not_add_up_are_found() -> None:
    none: dict[str, int | None] = dict.fromkeys(("sent", "applied", "superseded", "lost"))
    whole = {"sent": 10, "applied": 7, "superseded": 2, "lost": 1}
    assert unaccounted([none, whole]) == []
    assert unaccounted([whole | {"sent": 11}]) == ["11 sent, 7 + 2 + 1"]
