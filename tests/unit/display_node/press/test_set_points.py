import pytest
from hypothesis import given
from hypothesis import strategies as st

from display_node.press.set_points import PERIOD_NS, VALID_NS, SetPointSender
from protocol.errors import WireError
from protocol.summary.fields import SetPointCounts
from protocol.wire.messages import ProbeReport, SetPoint

SESSION, PRESS = 7, 11
MS = 1_000_000
LIMIT_N, SLEW = 3.0, 20.0


def sender() -> SetPointSender:
    return SetPointSender(PRESS, LIMIT_N, SLEW)


def sent(
    each: SetPointSender, now_ns: int, press_n: float = 1.0, session: int = SESSION
) -> SetPoint | None:
    return each.due(press_n, session, now_ns + 5, 100 * MS, now_ns)


def report(received: int, applied: int, superseded: int, **changes: object) -> ProbeReport:
    plain = ProbeReport(SESSION, PRESS, received, applied, superseded, 0, "pressing", 1.0, 1e-3)
    return plain._replace(**changes)


def answered() -> SetPointSender:
    """Return a sender of ten set-points, eight of which are accounted for."""
    each = sender()
    for number in range(10):
        sent(each, number * PERIOD_NS)
    each.take(report(8, 5, 1))
    return each


def test_fifty_set_points_a_second_are_numbered_and_dated() -> None:
    each = sender()
    messages = [message for now in range(1000) if (message := sent(each, now * MS))]
    assert [message.number for message in messages] == list(range(50))
    assert messages[1] == SetPoint(SESSION, PRESS, 1, PERIOD_NS + 5, VALID_NS + 100 * MS, 0.8)


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=1, max_size=50))
def test_no_press_passes_force_or_slew_limit(presses: list[float]) -> None:
    each, last_n = sender(), 0.0
    for number, press_n in enumerate(presses):
        message = sent(each, number * PERIOD_NS, press_n)
        assert message is not None
        assert 0.0 <= message.force_n <= LIMIT_N
        assert abs(message.force_n - last_n) <= SLEW * PERIOD_NS * 1e-9 + 1e-12
        last_n = message.force_n


def test_after_a_pause_the_set_point_begins_at_zero() -> None:
    each = sender()
    for number in range(50):
        sent(each, number * PERIOD_NS)
    assert each.set_point_n == 1.0
    message = sent(each, 50 * PERIOD_NS + VALID_NS)
    assert message is not None
    assert message.force_n == pytest.approx(SLEW * PERIOD_NS * 1e-9)


def test_the_account_closes_over_sessions() -> None:
    each = sender()
    for number in range(10):
        sent(each, number * PERIOD_NS)
    assert each.counts() == SetPointCounts(10, 0, 0, 10)
    assert each.take(report(9, 7, 1))
    assert each.counts() == SetPointCounts(10, 7, 1, 2)
    sent(each, 10 * PERIOD_NS, session=SESSION + 1)
    assert each.counts() == SetPointCounts(11, 7, 1, 3)
    assert each.take(report(1, 1, 0, session=SESSION + 1))
    assert each.counts() == SetPointCounts(11, 8, 1, 2)


@pytest.mark.parametrize(
    "wrong",
    [
        report(9, 7, 1, press=PRESS + 1),
        report(9, 7, 1, session=SESSION + 1),
        report(8, 5, 1),
        report(9, 6, 0),
    ],
    ids=["another display's", "another session's", "old", "same"],
)
def test_an_answer_to_another_or_an_older_one_is_ignored(wrong: ProbeReport) -> None:
    each = answered()
    assert not each.take(wrong)
    assert each.counts() == SetPointCounts(10, 5, 1, 4)


@pytest.mark.parametrize(
    ("false", "reason"),
    [
        (report(11, 7, 1), "11 set-points, 8 of them taken, and 10 were sent"),
        (report(9, 9, 1), "9 set-points, 10 of them taken, and 10 were sent"),
        (report(9, 6, 1, hold_down_n=-21.0), "-21 N at 0.001 m"),
        (report(9, 6, 1, depth_m=0.051), "1 N at 0.051 m"),
    ],
)
def test_an_answer_that_cannot_be_is_refused_with_the_reason(
    false: ProbeReport, reason: str
) -> None:
    each = answered()
    with pytest.raises(WireError, match=reason) as refused:
        each.take(false)
    assert refused.value.cause == "false_report"
    assert each.counts() == SetPointCounts(10, 5, 1, 4)


def test_it_is_known_that_another_display_presses() -> None:
    each = sender()
    sent(each, 0)
    assert not each.take(report(0, 0, 0, state="held"))
    assert each.held_by_other
    assert each.take(report(1, 1, 0))
    assert not each.held_by_other
