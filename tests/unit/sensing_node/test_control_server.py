import math

import msgpack
import pytest

from protocol.wire.messages import (
    Bye,
    ClockReply,
    ClockRequest,
    ControlMessage,
    DisplayReport,
    Hello,
    ProbeReport,
    SetPoint,
    Welcome,
    encode_control,
)
from sensing_node.control_server import (
    ADDRESS_BYTES,
    ANSWERS_AT_ONCE,
    DISPLAY_ANSWERS_PER_S,
    DISPLAY_REQUESTS_PER_S,
    FORGET_AFTER_NS,
    LEAST_PER_S,
    MAX_CLIENTS,
    MAX_HOPS,
    REQUESTS_AT_ONCE,
    STRANGERS_PER_S,
    ControlServer,
    RequestBudget,
    Sender,
)
from sensing_node.press.set_points import SetPointServer
from tests.support.streams import description

SESSION = 99
MS, SECOND_NS = 1_000_000, 1_000_000_000
NOW_NS = 8 * SECOND_NS
ANNA, BERT, CARL = (b"anna",), (b"bert",), (b"carl",)
HELLO = Hello("anna's")


class StillProbe:
    """A probe that rests."""

    state, hold_down_n, depth_m = "pressing", 0.0, 0.0

    def press(self, force_n: float) -> None:
        """Take a set-point."""


@pytest.fixture
def server() -> ControlServer:
    return ControlServer(description(), SESSION)


def ask(
    server: ControlServer, sender: Sender, message: ControlMessage, now_ns: int = NOW_NS
) -> ControlMessage | None:
    return server.answer(sender, encode_control(message), now_ns, samples_sent=1234)


def report(session: int = SESSION, played: int = 10) -> DisplayReport:
    return DisplayReport(session, "anna's", played, 3, 1, 2, 20.5, math.nan, 40, math.nan)


def test_the_last_report_of_each_display_is_kept(server: ControlServer) -> None:
    for sender in (ANNA, BERT):
        ask(server, sender, Hello("a display"))
    for played in (10, 20):
        assert ask(server, ANNA, report(played=played)) is None
    assert not server.rejected
    # A report of another session is counted and ignored.
    assert ask(server, ANNA, report(session=SESSION + 1, played=30)) is None
    assert server.rejected == {"session": 1}
    kept = server.clients[ANNA].report
    assert kept is not None
    assert kept.played == 20
    assert server.clients[BERT].report is None


def test_a_bye_confirms_the_whole_stream(server: ControlServer) -> None:
    assert not server.unconfirmed
    for sender in (ANNA, BERT):
        ask(server, sender, Hello(sender[0].decode()))
    ask(server, ANNA, report())
    ask(server, ANNA, Bye(SESSION, 1234))
    assert server.unconfirmed
    ask(server, BERT, Bye(SESSION + 1, 1234))
    assert server.unconfirmed
    assert server.rejected == {"session": 1}
    ask(server, BERT, Bye(SESSION, 1234))
    assert not server.unconfirmed
    # The last report is kept for the log at the end.
    assert server.clients[ANNA].report is not None


GREETING = encode_control(HELLO)


@pytest.mark.parametrize(
    ("sender", "data", "cause"),
    [
        *((ANNA, encode_control(message), "unexpected")
          for message in (Welcome(1, 0, description()), ClockReply(SESSION, 1, 2, 3))),
        (ANNA, GREETING[:-1], "truncated"),
        (ANNA, msgpack.packb([2, "bonjour", "anna's"]), "malformed"),
        (ANNA, msgpack.packb([3, "bonjour", "anna's"]), "version"),
        ((), GREETING, "malformed"),
        ((*ANNA, *(b"\0rela",) * MAX_HOPS), GREETING, "malformed"),
        # Two messages joined in transit.
        ((*ANNA, encode_control(ClockRequest(1))), GREETING, "malformed"),
        ((*ANNA, b""), GREETING, "malformed"),
        ((*ANNA, bytes(ADDRESS_BYTES + 1)), GREETING, "malformed"),
    ],
)  # fmt: skip
def test_an_invalid_message_is_counted_by_cause_and_not_answered(
    server: ControlServer, sender: Sender, data: bytes, cause: str
) -> None:
    for count in (1, 2):
        assert server.answer(sender, data, NOW_NS, 0) is None
        assert server.rejected == {cause: count}
    assert not server.clients


def test_a_display_of_another_version_is_refused_and_can_find_out(server: ControlServer) -> None:
    old = msgpack.packb([1, "hello", "anna's"])
    # The answer, which the old display refuses, has this node's version.
    assert isinstance(server.answer(ANNA, old, NOW_NS, 0), Welcome)
    assert server.rejected == {"version": 1}
    assert not server.clients
    assert server.other_version.startswith("the peer has version 1 of the protocol, this node ")
    # All strangers together are answered ten times a second.
    answers = [server.answer((b"%d" % i,), old, NOW_NS, 0) for i in range(20)]
    assert sum(answer is not None for answer in answers) == STRANGERS_PER_S - 1


@pytest.mark.parametrize("message", [HELLO, ClockRequest(1), report()])
def test_only_silent_displays_are_forgotten(server: ControlServer, message: ControlMessage) -> None:
    for sender in (ANNA, BERT):
        ask(server, sender, Hello(sender[0].decode()))
    later_ns = NOW_NS + FORGET_AFTER_NS
    assert server.forget_silent(later_ns) == []
    ask(server, ANNA, message, later_ns)
    assert [client.name for client in server.forget_silent(later_ns + 1)] == ["bert"]
    assert list(server.clients) == [ANNA]


def test_a_display_that_leaves_while_the_stream_lasts_is_forgotten_at_once(
    server: ControlServer,
) -> None:
    for sender in (ANNA, BERT):
        ask(server, sender, Hello(sender[0].decode()))
    ask(server, ANNA, Bye(SESSION, 0))
    assert [client.name for client in server.forget_silent(NOW_NS)] == ["anna"]
    assert list(server.clients) == [BERT]


@pytest.mark.parametrize("message", [ClockRequest(1), report()])
def test_a_forgotten_display_that_continues_is_a_client_again(
    server: ControlServer, message: ControlMessage
) -> None:
    ask(server, ANNA, HELLO)
    server.forget_silent(NOW_NS + FORGET_AFTER_NS + 1)
    for sent in (message, HELLO):
        ask(server, ANNA, sent)
        assert list(server.clients) == [ANNA]
    assert server.clients[ANNA].name == "anna's"


@pytest.mark.parametrize("message", [HELLO, report()])
@pytest.mark.parametrize("clock_first", [False, True])
def test_a_display_that_connects_again_is_one_client(
    server: ControlServer, message: ControlMessage, clock_first: bool
) -> None:
    ask(server, ANNA, HELLO)
    if clock_first:
        assert isinstance(ask(server, BERT, ClockRequest(1)), ClockReply)
        # Without a name, this may be another display.
        assert len(server.clients) == 2
    ask(server, BERT, message)
    assert list(server.clients) == [BERT]


def test_what_an_old_connection_of_a_forgotten_display_delivers_is_not_another_display(
    server: ControlServer,
) -> None:
    for sender, again in ((ANNA, False), (BERT, True)):
        ask(server, sender, HELLO)
        later_ns = NOW_NS + FORGET_AFTER_NS + 1
        assert [client.name for client in server.forget_silent(later_ns)] == ["anna's"]
        if again:
            ask(server, CARL, HELLO, later_ns)
        for _ in range(2):
            assert isinstance(ask(server, sender, ClockRequest(1), later_ns), ClockReply)
        assert [client.name for client in server.clients.values()] == ["anna's"]
        server.clients.clear()


@pytest.mark.parametrize("late_ms", [0, 400, 700])
def test_a_display_that_goes_back_to_its_first_connection_is_one_client(
    server: ControlServer, late_ms: int
) -> None:
    ask(server, ANNA, HELLO)
    ask(server, BERT, HELLO, NOW_NS + 250 * MS)
    server.clients[BERT].is_announced = True
    for now_ns in range(NOW_NS + 300 * MS, NOW_NS + FORGET_AFTER_NS + 2 * SECOND_NS, 100 * MS):
        # A message of the second connection may still be on its way.
        if late_ms and now_ns == NOW_NS + 300 * MS + late_ms * MS:
            ask(server, BERT, ClockRequest(1), now_ns)
        ask(server, ANNA, report() if now_ns % SECOND_NS == 0 else ClockRequest(now_ns), now_ns)
        assert server.forget_silent(now_ns) == []
    assert list(server.clients) == [ANNA]
    assert not server.clients[ANNA].is_twin
    assert server.clients[ANNA].is_announced


def test_two_displays_of_one_name_are_two_clients(server: ControlServer) -> None:
    """They neither replace each other again and again, nor lose their reports."""
    appeared, kept = 0, set[Sender]()
    for now_ns in range(NOW_NS, NOW_NS + 20 * SECOND_NS, 50 * MS):
        second = now_ns % SECOND_NS == 0
        for sender in (ANNA, BERT):
            if second:
                ask(server, sender, HELLO if now_ns == NOW_NS else report(), now_ns)
            assert isinstance(ask(server, sender, ClockRequest(now_ns), now_ns), ClockReply)
            appeared += len(server.clients.keys() - kept)
            kept = set(server.clients)
        if second:
            assert server.forget_silent(now_ns) == []
    # The first of them was replaced by the second, until it went on.
    assert appeared == 3
    assert {sender: each.name for sender, each in server.clients.items()} == {
        ANNA: "anna's",
        BERT: "anna's",
    }
    assert all(client.report is not None for client in server.clients.values())
    # Each that connects again replaces its own old entry, which is silent.
    later_ns = NOW_NS + 22 * SECOND_NS
    ask(server, BERT, ClockRequest(1), later_ns)
    ask(server, CARL, HELLO, later_ns)
    assert set(server.clients) == {BERT, CARL}


def test_what_an_old_connection_delivers_late_makes_no_display(server: ControlServer) -> None:
    ask(server, ANNA, HELLO)
    ask(server, BERT, HELLO)
    late_ns = NOW_NS + 3 * SECOND_NS
    for message in (ClockRequest(1), report(), ClockRequest(2), report()):
        ask(server, ANNA, message, late_ns)
        late_ns += MS
    ask(server, ANNA, Bye(SESSION, 1234), late_ns)
    ask(server, BERT, HELLO, late_ns)
    assert list(server.clients) == [BERT]
    assert server.forget_silent(late_ns) == []


def test_a_display_that_connects_again_has_room_where_there_is_no_other(
    server: ControlServer,
) -> None:
    for number in range(MAX_CLIENTS):
        ask(server, (b"%d" % number,), Hello(f"display {number}"))
    assert isinstance(ask(server, ANNA, Hello("display 7")), Welcome)
    assert (b"7",) not in server.clients
    assert len(server.clients) == MAX_CLIENTS
    assert not server.rejected


def test_a_connection_that_began_with_a_set_point_is_no_display() -> None:
    server = ControlServer(description(), SESSION, SetPointServer(SESSION, StillProbe()))
    ask(server, ANNA, HELLO)
    set_point = SetPoint(SESSION, 5, 0, NOW_NS, SECOND_NS, 1.0)
    assert isinstance(ask(server, BERT, set_point), ProbeReport)
    assert isinstance(ask(server, BERT, ClockRequest(1)), ClockReply)
    assert list(server.clients) == [ANNA]
    ask(server, ANNA, Bye(SESSION, 1234))
    assert not server.unconfirmed
    assert [client.confirmed for client in server.forget_silent(NOW_NS)] == [True]
    # It is forgotten without a word, and a hello makes it a display.
    later_ns = NOW_NS + FORGET_AFTER_NS + 1
    ask(server, ANNA, HELLO, later_ns)
    assert server.forget_silent(later_ns) == []
    ask(server, BERT, set_point._replace(number=1, t_ns=later_ns), later_ns)
    ask(server, BERT, Hello("bert's"), later_ns)
    assert [client.name for client in server.clients.values()] == ["anna's", "bert's"]
    assert not server.rejected


def test_further_connections_count_among_the_bounded_clients() -> None:
    server = ControlServer(description(), SESSION, SetPointServer(SESSION, StillProbe()))
    set_point = SetPoint(SESSION, 5, 0, NOW_NS, SECOND_NS, 1.0)
    for number in range(MAX_CLIENTS):
        ask(server, (number.to_bytes(4, "little"),), set_point._replace(number=number))
    assert ask(server, BERT, set_point._replace(number=MAX_CLIENTS)) is None
    assert ask(server, ANNA, HELLO) is None
    assert server.rejected == {"too_many_displays": 2}


def test_clients_and_their_addresses_are_bounded(server: ControlServer) -> None:
    for number in range(2 * MAX_CLIENTS):
        greeting = encode_control(Hello(f"display {number}"))
        for address in (bytes(200_000), bytes(ADDRESS_BYTES)):
            server.answer((str(number).encode(), address), greeting, number, 0)
    assert len(server.clients) == MAX_CLIENTS
    assert server.rejected == {"malformed": 2 * MAX_CLIENTS, "too_many_displays": MAX_CLIENTS}
    for message in (HELLO, ClockRequest(1), report()):
        assert ask(server, ANNA, message) is None
    assert isinstance(ask(server, (b"0", bytes(ADDRESS_BYTES)), Hello("display 0")), Welcome)


def test_a_flooding_display_gets_few_answers_and_others_get_all(server: ControlServer) -> None:
    flooded = answered = 0
    for now_ns in range(NOW_NS, NOW_NS + 10 * SECOND_NS, SECOND_NS // 50):
        for _ in range(100):
            flooded += ask(server, ANNA, ClockRequest(now_ns), now_ns) is not None
        answered += ask(server, BERT, ClockRequest(now_ns), now_ns) is not None
    assert answered == 500
    assert flooded <= ANSWERS_AT_ONCE + 10 * DISPLAY_ANSWERS_PER_S
    assert server.rejected["flood"] == 50_000 - flooded


@pytest.mark.parametrize(
    ("displays", "per_ms", "least", "most"),
    [
        # Two displays flood. Each pause admits one message beyond the budget, 200 a second.
        (2, 75, 0.5, REQUESTS_AT_ONCE + 10 * (LEAST_PER_S + 2 * DISPLAY_REQUESTS_PER_S + 200)),
        # A hundred displays send 60 a second each, and all are read.
        (100, 6, 1.0, 60_000),
    ],
)
def test_messages_beyond_the_budget_are_not_read(
    displays: int, per_ms: int, least: float, most: float
) -> None:
    budget = RequestBudget()
    budget.expect(displays)
    read = waiting = 0
    for now_ns in range(0, 10 * SECOND_NS, MS):
        waiting += per_ms
        while waiting and not budget.held_for_ns(now_ns):
            read, waiting = read + 1, waiting - 1
            budget.spend(now_ns)
    assert least * most <= read <= most
    assert (budget.held > 0) == (least < 1)


def test_a_clock_that_steps_back_ends_a_pause() -> None:
    budget = RequestBudget()
    later_ns = 3_600 * SECOND_NS
    while budget.spend(later_ns):
        pass
    assert budget.held_for_ns(later_ns) > 0
    assert budget.held_for_ns(0) == 0
