import pytest

from soak.accounts import Mark, Session, reckon, unaccounted

S, MS = 1_000_000_000, 1_000_000
FIRST = Session(began_ns=0, ended_ns=10 * S, period_ns=MS, least=10_000, most=10_000)
# Killed at 30 s: the number of samples sent by then is not known exactly.
KILLED = Session(began_ns=20 * S, ended_ns=30 * S, period_ns=MS, least=9_990, most=10_005)
KILL = (30 * S, 32 * S)
PLAYED, REPORTED = (5, "playing", 4_900), (15, "ended", 10_000)
Row = tuple[float, str, int]


def marks(*rows: Row) -> list[Mark]:
    return [Mark(round(at_s * S), state, total) for at_s, state, total in rows]


@pytest.mark.parametrize(("total", "off"), [(10_000, 0), (9_999, 1), (10_001, -1), (1, 9_999)])
def test_a_session_whose_end_was_reported_is_accounted_for_to_the_sample(
    total: int, off: int
) -> None:
    (found,) = reckon(marks(PLAYED, (11, "ended", total)), [FIRST], [])
    assert (found.exact, found.off) == (True, off)


@pytest.mark.parametrize(
    ("total", "faults", "off"),
    [
        (20_005, [KILL], 0),
        (19_000, [KILL], 0),
        (18_999, [KILL], 1),
        (20_006, [KILL], -1),
        # A fault shortly after another excuses what began with the first.
        (14_000, [(25 * S, 28 * S), KILL], 0),
        (13_999, [(25 * S, 28 * S), KILL], 1),
    ],
)
def test_only_the_tail_of_a_killed_session_may_be_missing(
    total: int, faults: list[tuple[int, int]], off: int
) -> None:
    rows = marks(PLAYED, REPORTED, (29, "playing", 18_900), (33, "starting", total))
    exact, open_end = reckon(rows, [FIRST, KILLED], faults)
    assert exact.off == 0
    assert (open_end.exact, open_end.off) == (False, off)


@pytest.mark.parametrize(
    ("rows", "off"),
    [
        # A session that was over before the display joined may count or not.
        (((29.9, "waiting", 0), (41, "ended", 8_000)), 0),
        (((29.9, "waiting", 0), (41, "ended", 18_000)), 0),
        (((29.9, "playing", 1), (41, "ended", 8_000)), 9_000),
    ],
)
def test_after_a_killed_session_the_next_end_sums_up_both(rows: tuple[Row, ...], off: int) -> None:
    last = Session(began_ns=32 * S, ended_ns=40 * S, period_ns=MS, least=8_000, most=8_000)
    (found,) = reckon(marks(*rows), [KILLED, last], [])
    assert found.off == off
    assert reckon(marks((5, "waiting", 0)), [FIRST], []) == []


def test_set_points_that_do_not_add_up_are_found() -> None:
    whole = {"sent": 10, "applied": 7, "superseded": 2, "lost": 1}
    assert unaccounted([dict.fromkeys(whole), whole]) == []
    assert unaccounted([whole | {"sent": 11}]) == ["11 sent, 7 + 2 + 1"]
