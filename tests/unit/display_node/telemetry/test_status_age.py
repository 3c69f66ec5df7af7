"""Age of a status by the stamps of the traces, where reader and display stall."""

import pytest

from display_node.telemetry.status_age import WINDOW_NS, StatusAge

MS, SECOND_NS = 1_000_000, 1_000_000_000
HOUR_NS = 3600 * SECOND_NS


def receive(age: StatusAge, ahead_ns: int, from_ns: int, to_ns: int = 0, delay_ns: int = MS) -> int:
    """Receive trace and status every 100 ms until `to_ns`, from a clock `ahead_ns` ahead.

    Returns the time on the reader's clock at which the last ones were sent.
    """
    for now_ns in range(from_ns, to_ns or from_ns + 1, 100 * MS):
        age.take_trace(now_ns + ahead_ns, now_ns + delay_ns)
        age.take_status(now_ns + delay_ns)
    return now_ns


def test_without_a_stamp_the_age_counts_from_the_receipt() -> None:
    age, before_the_first_trace = StatusAge(), StatusAge()
    age.take_trace(0, 0)
    assert age.age_ns(HOUR_NS) is None
    before_the_first_trace.take_status(SECOND_NS)
    assert before_the_first_trace.age_ns(3 * SECOND_NS) == 2 * SECOND_NS


def test_on_this_machine_queued_telemetry_is_as_old_as_its_stamp() -> None:
    age = StatusAge(local=True)
    receive(age, 0, HOUR_NS, delay_ns=3 * SECOND_NS)
    assert age.age_ns(HOUR_NS + 3 * SECOND_NS) == 3 * SECOND_NS


@pytest.mark.parametrize("local", [True, False])
@pytest.mark.parametrize("ahead_ns", [-HOUR_NS, HOUR_NS])
def test_over_another_clock_age_is_beyond_the_shortest_transit(local: bool, ahead_ns: int) -> None:
    """The address of a tunnel is on this machine, the clock of its display is not."""
    age = StatusAge(local)
    last_ns = receive(age, ahead_ns, HOUR_NS, HOUR_NS + 2 * SECOND_NS, delay_ns=30 * MS)
    assert age.age_ns(last_ns + 30 * MS) == 0
    # The reader stalls for 5 s; the telemetry that it receives then has queued for 4 s.
    receive(age, ahead_ns, last_ns + SECOND_NS, delay_ns=4 * SECOND_NS)
    assert age.age_ns(last_ns + 5 * SECOND_NS) == 4 * SECOND_NS - 30 * MS


def test_a_trace_of_the_next_process_does_not_make_a_killed_ones_status_current() -> None:
    age = StatusAge(local=True)
    last_ns = receive(age, 0, HOUR_NS, HOUR_NS + SECOND_NS)
    back_ns = last_ns + 3 * SECOND_NS
    age.take_trace(back_ns, back_ns)
    assert age.age_ns(back_ns) == 3 * SECOND_NS


def test_drifting_clocks_do_not_age_the_newest_status() -> None:
    age = StatusAge()
    for step in range(0, 12 * HOUR_NS, 10 * SECOND_NS):
        receive(age, -step // 20_000, step, delay_ns=0)
        found_ns = age.age_ns(step)
        assert found_ns is not None
        assert found_ns <= 2 * WINDOW_NS // 20_000


def test_a_restart_of_the_displays_machine_resets_the_offset() -> None:
    age = StatusAge()
    last_ns = receive(age, HOUR_NS, HOUR_NS, HOUR_NS + SECOND_NS)
    back_ns = last_ns + 60 * SECOND_NS
    last_ns = receive(age, -back_ns, back_ns, back_ns + SECOND_NS)
    assert age.age_ns(last_ns + MS) == 0


def test_a_status_is_valid_while_traces_follow_it() -> None:
    """With ticks of 10 ms there is a status only every 2 s."""
    age = StatusAge(local=True)
    receive(age, 0, 0, delay_ns=0)
    for now_ns in range(200 * MS, 2_000 * MS, 200 * MS):
        assert age.age_ns(now_ns) == 200 * MS
        age.take_trace(now_ns, now_ns)
    # After a gap between traces it is not, whatever follows.
    age.take_trace(5 * SECOND_NS, 5 * SECOND_NS)
    age.take_trace(5_200 * MS, 5_200 * MS)
    assert age.age_ns(5_200 * MS) == 3_400 * MS
