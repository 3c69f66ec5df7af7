from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.summary.fields import SetPointCounts
from protocol.wire.messages import ProbeReport, SetPoint
from sensing_node.press.set_points import (
    EARLIEST_NS,
    HELD_FOR_NS,
    LARGEST_STEP,
    LATEST_NS,
    MOST_HOLDERS,
    REMEMBERED,
    SetPointServer,
)

SESSION, ANNA, BERT = 7, 11, 12
MS = 1_000_000
NOW_NS = 5_000 * MS
VALID_NS = 300 * MS


@dataclass
class RecordingProbe:
    forces: list[float] = field(default_factory=list)
    state: str = "pressing"
    hold_down_n: float = 0.5
    depth_m: float = 1e-3

    def press(self, force_n: float) -> None:
        self.forces.append(force_n)


@pytest.fixture
def probe() -> RecordingProbe:
    return RecordingProbe()


@pytest.fixture
def server(probe: RecordingProbe) -> SetPointServer:
    return SetPointServer(SESSION, probe)


def send(
    server: SetPointServer,
    number: int,
    press: int = ANNA,
    now_ns: int = NOW_NS,
    age_ns: int = 0,
    force_n: float = 1.0,
) -> ProbeReport:
    message = SetPoint(SESSION, press, number, now_ns - age_ns, VALID_NS, force_n)
    return server.answer(message, now_ns)


def account(server: SetPointServer) -> SetPointCounts:
    found = server.figures()
    return SetPointCounts(found.sent, found.applied, found.superseded, found.lost)


def test_one_out_of_order_and_a_late_one_are_superseded(
    server: SetPointServer, probe: RecordingProbe
) -> None:
    send(server, 0)
    send(server, 2)
    assert account(server) == SetPointCounts(3, 2, 0, 1)
    send(server, 1, force_n=9.0)
    assert account(server) == SetPointCounts(3, 2, 1, 0)
    # The newest one is not stale while earlier ones still arrive in time.
    assert probe.forces == [1.0, 1.0, 1.0]
    send(server, 3, age_ns=VALID_NS + 1)
    assert account(server) == SetPointCounts(4, 2, 2, 0)
    send(server, 4, age_ns=VALID_NS)
    assert account(server) == SetPointCounts(5, 3, 2, 0)
    assert len(probe.forces) == 4


@pytest.mark.parametrize(
    ("number", "age_ns", "cause"),
    [
        (5_000, 0, "duplicate"),
        (4_990, 0, "duplicate"),
        (5_000 - REMEMBERED, 0, "too_old"),
        (5_001 + LARGEST_STEP, 0, "implausible"),
        (2**53 - 1, 0, "implausible"),
        (5_001, EARLIEST_NS + 1, "timestamp"),
        (5_001, -LATEST_NS - 1, "timestamp"),
    ],
)
def test_a_replayed_old_or_impossible_one_is_refused_and_not_applied(
    server: SetPointServer, probe: RecordingProbe, number: int, age_ns: int, cause: str
) -> None:
    for each in range(4_980, 5_001):
        send(server, each)
    before, applied = account(server), len(probe.forces)
    assert send(server, number, age_ns=age_ns).refused == 1
    assert server.rejected == {cause: 1}
    assert account(server) == before
    assert len(probe.forces) == applied


def test_only_the_display_that_presses_may_press_until_it_is_silent(
    server: SetPointServer, probe: RecordingProbe
) -> None:
    send(server, 0, ANNA, force_n=1.0)
    refused = send(server, 0, BERT, NOW_NS + HELD_FOR_NS, force_n=2.0)
    assert (refused.press, refused.state, refused.received) == (BERT, "held", 0)
    assert server.rejected == {"press_held": 1}
    send(server, 1, BERT, NOW_NS + HELD_FOR_NS + 1, force_n=2.0)
    assert probe.forces == [1.0, 2.0]
    # Now the other one is refused.
    assert send(server, 1, ANNA, NOW_NS + HELD_FOR_NS + 2).state == "held"
    assert account(server) == SetPointCounts(3, 2, 0, 1)


def test_refused_set_points_do_not_keep_the_permission(server: SetPointServer) -> None:
    send(server, 0, ANNA)
    for _ in range(10):
        send(server, 0, ANNA, NOW_NS + HELD_FOR_NS)
    assert send(server, 0, BERT, NOW_NS + HELD_FOR_NS + 1).state == "pressing"


def test_a_display_that_returns_continues_its_account(server: SetPointServer) -> None:
    send(server, 0, ANNA)
    later_ns = NOW_NS + HELD_FOR_NS + 1
    send(server, 0, BERT, later_ns)
    report = send(server, 2, ANNA, later_ns + HELD_FOR_NS + 1)
    assert (report.received, report.applied) == (3, 2)
    assert account(server) == SetPointCounts(4, 3, 0, 1)


def test_accounts_of_many_displays_are_summed_in_bounded_memory(server: SetPointServer) -> None:
    for press in range(3 * MOST_HOLDERS):
        send(server, 1, press, NOW_NS + press * (HELD_FOR_NS + 1))
    assert len(server._holders) == MOST_HOLDERS
    assert account(server) == SetPointCounts(
        6 * MOST_HOLDERS, 3 * MOST_HOLDERS, 0, 3 * MOST_HOLDERS
    )


@given(
    st.lists(
        st.tuples(st.integers(0, 200), st.integers(0, 2 * VALID_NS), st.sampled_from([ANNA, BERT])),
        max_size=60,
    )
)
def test_the_account_closes_whatever_arrives(arrivals: list[tuple[int, int, int]]) -> None:
    probe = RecordingProbe()
    server = SetPointServer(SESSION, probe)
    for step, (number, age_ns, press) in enumerate(arrivals):
        send(server, number, press, NOW_NS + step * 100 * MS, age_ns)
    total = account(server)
    assert None not in (total.sent, total.applied, total.superseded, total.lost)
    assert total.sent == (total.applied or 0) + (total.superseded or 0) + (total.lost or 0)
    taken = (total.applied or 0) + (total.superseded or 0)
    assert (total.applied or 0) <= len(probe.forces) <= taken
    assert taken + server.rejected.total() == len(arrivals)
