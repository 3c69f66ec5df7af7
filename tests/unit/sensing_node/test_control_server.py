import math

import msgpack
import pytest

from protocol.wire.messages import (
    Bye,
    ClockReply,
    ClockRequest,
    Control,
    DisplayReport,
    Hello,
    Welcome,
    encode_control,
)
from sensing_node.control_server import (
    ANSWERS_AT_ONCE,
    ANSWERS_PER_S,
    FORGET_AFTER_NS,
    MAX_GUESTS,
    MAX_HOPS,
    ControlServer,
    Sender,
)
from tests.support.streams import description

SESSION = 99
NOW_NS = 8_000_000_000
ANNA, BERT = (b"anna",), (b"bert",)


@pytest.fixture
def desk() -> ControlServer:
    return ControlServer(description(), SESSION)


def ask(
    desk: ControlServer, sender: Sender, message: Control, now_ns: int = NOW_NS
) -> Control | None:
    return desk.answer(sender, encode_control(message), now_ns, samples_sent=1234)


def report(session: int = SESSION, played: int = 10) -> DisplayReport:
    return DisplayReport(session, "anna's", played, 1, 2, 20.5, math.nan, 40, math.nan)


def test_a_hello_is_welcomed_with_the_stream(desk: ControlServer) -> None:
    assert ask(desk, ANNA, Hello("anna's")) == Welcome(SESSION, 1234, description())
    assert desk.guests[ANNA].name == "anna's"
    assert not desk.rejected


def test_a_second_hello_is_welcomed_too_but_is_the_same_guest(desk: ControlServer) -> None:
    ask(desk, ANNA, Hello("anna's"))
    ask(desk, ANNA, report())
    assert isinstance(ask(desk, ANNA, Hello("anna's")), Welcome)
    assert len(desk.guests) == 1
    assert desk.guests[ANNA].report is not None


@pytest.mark.parametrize("t1_ns", [0, -5, 123_456_789_012_345_678])
def test_a_clock_request_gets_its_own_time_back_and_ours(desk: ControlServer, t1_ns: int) -> None:
    assert ask(desk, ANNA, ClockRequest(t1_ns)) == ClockReply(SESSION, t1_ns, NOW_NS, NOW_NS)


def test_the_last_report_of_each_display_is_kept(desk: ControlServer) -> None:
    for sender in (ANNA, BERT):
        ask(desk, sender, Hello("a display"))
    for played in (10, 20):
        assert ask(desk, ANNA, report(played=played)) is None
    kept = desk.guests[ANNA].report
    assert kept is not None
    assert kept.played == 20
    assert desk.guests[BERT].report is None
    assert not desk.rejected


def test_a_report_of_another_session_is_counted_and_not_kept(desk: ControlServer) -> None:
    ask(desk, ANNA, Hello("anna's"))
    assert ask(desk, ANNA, report(session=SESSION + 1)) is None
    assert desk.guests[ANNA].report is None
    assert desk.rejected == {"session": 1}


def test_a_bye_says_that_a_display_has_the_whole_stream(desk: ControlServer) -> None:
    assert desk.all_content
    for sender in (ANNA, BERT):
        ask(desk, sender, Hello(sender[0].decode()))
    ask(desk, ANNA, report())
    ask(desk, ANNA, Bye(SESSION, 1234))
    assert not desk.all_content
    ask(desk, BERT, Bye(SESSION + 1, 1234))
    assert not desk.all_content
    assert desk.rejected == {"session": 1}
    ask(desk, BERT, Bye(SESSION, 1234))
    assert desk.all_content
    # Its last report is wanted in the end.
    assert desk.guests[ANNA].report is not None


@pytest.mark.parametrize("message", [Welcome(1, 0, description()), ClockReply(SESSION, 1, 2, 3)])
def test_what_only_a_sensing_node_sends_is_unexpected(
    desk: ControlServer, message: Control
) -> None:
    assert ask(desk, ANNA, message) is None
    assert desk.rejected == {"unexpected": 1}
    assert not desk.guests


HELLO = encode_control(Hello("anna's"))


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (b"", "truncated"),
        (HELLO[:-1], "truncated"),
        (b"\xc1" * 8, "not_msgpack"),
        (HELLO + b"\0", "not_msgpack"),
        (msgpack.packb([1, "bonjour", "anna's"]), "malformed"),
        (msgpack.packb([1, "hello", 7]), "malformed"),
        (msgpack.packb({"hello": 1}), "malformed"),
        (msgpack.packb([2, "hello", "anna's"]), "version"),
        (bytes(100_000), "oversized"),
    ],
)
def test_garbage_is_counted_by_cause_and_gets_no_answer(
    desk: ControlServer, data: bytes, cause: str
) -> None:
    for count in (1, 2):
        assert desk.answer(ANNA, data, NOW_NS, 0) is None
        assert desk.rejected == {cause: count}
    assert not desk.guests


def test_a_message_may_come_through_relays(desk: ControlServer) -> None:
    through = (b"relay", *(b"\0anna",) * (MAX_HOPS - 1))
    assert isinstance(ask(desk, through, Hello("anna's")), Welcome)
    assert list(desk.guests) == [through]


@pytest.mark.parametrize(
    "sender",
    [
        (),
        (*ANNA, *(b"\0rela",) * MAX_HOPS),
        # Two messages that were joined on the way.
        (*ANNA, encode_control(ClockRequest(1))),
        (*ANNA, b""),
    ],
)
def test_an_impossible_envelope_is_garbage(desk: ControlServer, sender: Sender) -> None:
    assert ask(desk, sender, Hello("anna's")) is None
    assert desk.rejected == {"malformed": 1}
    assert not desk.guests


@pytest.mark.parametrize("sign_of_life", [Hello("anna's"), ClockRequest(1), report()])
def test_only_silent_displays_are_forgotten(desk: ControlServer, sign_of_life: Control) -> None:
    for sender in (ANNA, BERT):
        ask(desk, sender, Hello(sender[0].decode()))
    later_ns = NOW_NS + FORGET_AFTER_NS
    assert desk.forget_silent(later_ns) == []
    ask(desk, ANNA, sign_of_life, later_ns)
    assert [guest.name for guest in desk.forget_silent(later_ns + 1)] == ["bert"]
    assert list(desk.guests) == [ANNA]


@pytest.mark.parametrize("message", [ClockRequest(1), report()])
def test_a_display_that_goes_on_after_it_was_forgotten_is_a_guest_again(
    desk: ControlServer, message: Control
) -> None:
    ask(desk, ANNA, Hello("anna's"))
    desk.forget_silent(NOW_NS + FORGET_AFTER_NS + 1)
    ask(desk, ANNA, message)
    assert list(desk.guests) == [ANNA]
    ask(desk, ANNA, Hello("anna's"))
    assert desk.guests[ANNA].name == "anna's"


def test_guests_are_bounded_and_known_ones_stay_welcome(desk: ControlServer) -> None:
    for number in range(MAX_GUESTS):
        assert ask(desk, (str(number).encode(),), Hello(f"display {number}")) is not None
    for message in (Hello("anna's"), ClockRequest(1), report()):
        assert ask(desk, ANNA, message) is None
    assert len(desk.guests) == MAX_GUESTS
    assert desk.rejected == {"too_many_displays": 3}
    assert isinstance(ask(desk, (b"0",), Hello("display 0")), Welcome)


def test_a_display_that_connects_anew_is_one_guest(desk: ControlServer) -> None:
    for sender in (ANNA, BERT):
        ask(desk, sender, Hello("anna's"))
    assert list(desk.guests) == [BERT]


@pytest.mark.parametrize("message", [Hello("anna's"), report()])
def test_a_display_that_asks_for_the_clock_before_it_says_its_name_is_one_guest(
    desk: ControlServer, message: Control
) -> None:
    ask(desk, ANNA, Hello("anna's"))
    assert isinstance(ask(desk, BERT, ClockRequest(1)), ClockReply)
    # It may as well be another display.
    assert len(desk.guests) == 2
    ask(desk, BERT, message)
    assert list(desk.guests) == [BERT]


@pytest.mark.parametrize(
    ("name", "shown"),
    [("anna's", "anna's"), ("", "a display"), ("Zoë", r"Zo\xeb")],
)
def test_a_name_is_shown_in_letters_that_every_terminal_has(
    desk: ControlServer, name: str, shown: str
) -> None:
    ask(desk, ANNA, Hello(name))
    assert desk.guests[ANNA].shown_name == shown


def test_a_display_that_floods_gets_few_answers_and_others_all_of_theirs(
    desk: ControlServer,
) -> None:
    second_ns, flooded, answered = 1_000_000_000, 0, 0
    for now_ns in range(NOW_NS, NOW_NS + 10 * second_ns, second_ns // 50):
        for _ in range(100):
            flooded += ask(desk, ANNA, ClockRequest(now_ns), now_ns) is not None
        answered += ask(desk, BERT, ClockRequest(now_ns), now_ns) is not None
    assert answered == 500
    assert flooded <= ANSWERS_AT_ONCE + 10 * ANSWERS_PER_S
    assert desk.rejected["flood"] == 50_000 - flooded
