"""Whoever asks whatever how often: the desk answers or counts, and keeps no more than it may."""

import tracemalloc

from hypothesis import given, settings
from hypothesis import strategies as st

from protocol.wire.messages import Bye, ClockRequest, DisplayReport, Hello, encode_control
from sensing_node.control_server import ADDRESS_BYTES, FORGET_AFTER_NS, MAX_GUESTS, ControlServer
from tests.support.streams import description

SESSION = 9
MOST_BYTES = 3_000_000
HELLO = encode_control(Hello("one"))

names = st.sampled_from(["", "one", "two", "é" * 80])
counts = st.integers(0, 2**53 - 1)
figures = st.floats() | st.integers(-(2**63), 2**64 - 1)
messages = st.one_of(
    st.builds(Hello, names),
    st.builds(ClockRequest, st.integers(-(2**62), 2**62 - 1)),
    st.builds(Bye, st.sampled_from([SESSION, 8]), counts),
    st.builds(
        DisplayReport,
        *(st.sampled_from([SESSION, 8]), names, counts, counts, counts),
        *(figures, figures, figures, figures),
    ),
)
senders = st.lists(st.binary(max_size=4), max_size=6).map(tuple)


@settings(max_examples=150)
@given(st.lists(st.tuples(senders, messages, st.integers(0, FORGET_AFTER_NS)), max_size=40))
def test_a_guest_is_whoever_said_something_valid_not_long_ago(said: list) -> None:
    desk, now_ns = ControlServer(description(), SESSION), 0
    spoke_ns: dict[tuple[bytes, ...], int] = {}
    for sender, message, later_ns in said:
        now_ns += later_ns
        refused = desk.rejected["malformed"]
        desk.answer(sender, encode_control(message), now_ns, 100)
        if desk.rejected["malformed"] == refused:
            assert 1 <= len(sender) <= 4
            spoke_ns[sender] = now_ns
        desk.forget_silent(now_ns)
        recent = {who for who, at_ns in spoke_ns.items() if now_ns - at_ns <= FORGET_AFTER_NS}
        # One that comes by another address under the same name has replaced the one of before.
        assert set(desk.guests) <= recent
        named = [guest.name for guest in desk.guests.values() if guest.name]
        assert len(named) == len(set(named))


def test_an_address_of_other_length_than_zeromq_makes_is_refused() -> None:
    desk = ControlServer(description(), SESSION)
    assert desk.answer((b"peer", bytes(ADDRESS_BYTES)), HELLO, 0, 0) is not None
    assert desk.answer((b"peer", bytes(ADDRESS_BYTES + 1)), HELLO, 0, 0) is None
    assert desk.rejected == {"malformed": 1}


def test_a_crowd_with_long_addresses_costs_little() -> None:
    desk = ControlServer(description(), SESSION)
    tracemalloc.start()
    try:
        for number in range(2 * MAX_GUESTS):
            said = encode_control(Hello(f"display {number}"))
            desk.answer((str(number).encode(), bytes(200_000)), said, number, 0)
            desk.answer((str(number).encode(), bytes(ADDRESS_BYTES)), said, number, 0)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(desk.guests) == MAX_GUESTS
    assert desk.rejected == {"malformed": 2 * MAX_GUESTS, "too_many_displays": MAX_GUESTS}
    assert held < MOST_BYTES
