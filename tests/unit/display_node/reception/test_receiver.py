import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from display_node.reception.receiver import MAX_OPEN_REQUESTS, Receiver
from protocol.wire.description import Channel
from protocol.wire.messages import (
    Bye,
    ClockReply,
    ClockRequest,
    Frame,
    Hello,
    Welcome,
    encode_control,
    encode_frame,
)
from tests.support.sender import AHEAD_NS, MS, Sender
from tests.support.streams import description


def joined(sender: Sender, paths: int = 1, channel: int = 0) -> Receiver:
    """Return a receiver that has the stream's description and its clock, at 100 ms."""
    receiver = Receiver("test", [channel], late_target=0.01, paths=paths)
    sender.serve(receiver, 0, until_ms=101)
    return receiver


def test_hello_is_repeated_until_the_welcome_and_frames_before_the_clock_are_refused() -> None:
    receiver, sender = Receiver("test", [0], 0.01), Sender()
    asked = [ns for ns in range(0, 2000 * MS, MS) if receiver.requests(ns)]
    assert len(asked) == 8
    receiver.on_control(encode_control(Welcome(7, 0, sender.stream)), 2000 * MS)
    receiver.on_frame(sender.frame(0, 0.3), 2000 * MS)
    assert receiver.rejected == {"before_clock": 1}
    requests = [r for ns in range(2000 * MS, 2900 * MS, MS) for r in receiver.requests(ns)]
    assert {type(r) for r in requests} == {ClockRequest}


def test_a_node_of_another_version_is_refused_and_named() -> None:
    receiver, sender = Receiver("test", 0, 0.01), Sender()
    _, *welcome = msgpack.unpackb(encode_control(Welcome(7, 0, sender.stream)))
    receiver.on_control(msgpack.packb([1, *welcome]), 4000 * MS)
    assert receiver.rejected == {"version": 1}
    assert receiver.other_version.startswith("the peer has version 1 of the protocol, this node ")
    assert receiver.session is None


def test_playing_starts_after_a_quarter_second_of_frames() -> None:
    receiver = joined(sender := Sender())
    ready = []
    for ms in range(100, 400, 5):
        receiver.on_frame(sender.frame(ms * MS, 0.3), ms * MS)
        ready.append(receiver.ready)
    assert not any(ready[:50])
    assert ready[-1]


def test_a_stream_is_live_until_its_newest_sample_is_too_old() -> None:
    receiver, stale_ns = joined(sender := Sender()), 60 * MS
    assert not receiver.live(0, 0, stale_ns)
    for ms in range(100, 400, 5):
        receiver.on_frame(sender.frame(ms * MS, 0.3), ms * MS)
    newest_ns, delay_ns = receiver.buffer.newest_ns, receiver.link_delay.delay_ns
    assert newest_ns is not None
    assert delay_ns is not None
    last_ns = newest_ns + stale_ns
    assert receiver.live(last_ns, last_ns + delay_ns + 1, stale_ns)
    assert receiver.live(last_ns + 1, last_ns + delay_ns, stale_ns)
    assert not receiver.live(last_ns + 1, last_ns + delay_ns + 1, stale_ns)


def bad_frames(sender: Sender) -> dict[str, tuple[bytes, str]]:
    t_ns = 200 * MS + AHEAD_NS

    def frame(**changes: object) -> bytes:
        values = np.full((5, 1), 0.3, "<f4")
        base = Frame(sender.session, 100, t_ns, MS, values)
        return encode_frame(base._replace(**changes))

    return {
        "another session": (frame(session=8), "session"),
        "NaN": (frame(values=np.full((5, 1), np.nan, "<f4")), "not_finite"),
        "more channels": (frame(values=np.zeros((5, 2), "<f4")), "mismatch"),
        "more samples than a batch": (frame(values=np.zeros((6, 1), "<f4")), "mismatch"),
        "another sample format": (frame(values=np.zeros((5, 1), "<f8")), "mismatch"),
        "another rate": (frame(period_ns=5 * MS), "mismatch"),
        "from the future": (frame(t_first_ns=t_ns + 3_000 * MS), "timestamp"),
        "from long ago": (frame(t_first_ns=t_ns - 3_600_000 * MS), "timestamp"),
    }


@pytest.mark.parametrize("name", list(bad_frames(Sender())))
def test_a_bad_frame_is_refused_under_its_cause(name: str) -> None:
    receiver = joined(sender := Sender())
    data, cause = bad_frames(sender)[name]
    assert receiver.on_frame(data, 200 * MS) is None
    assert receiver.rejected == {cause: 1}
    assert receiver.frames == (0, 0)


def test_duplicates_are_refused_or_copies_of_another_path_and_disorder_is_counted() -> None:
    for paths, copies, rejected in ((1, 0, {"duplicate": 2}), (3, 2, {})):
        receiver = joined(sender := Sender(), paths)
        frames = [sender.frame((200 + 5 * i) * MS, 0.3) for i in range(4)]
        for i in (0, 2, 1, 1, 1, 3):
            receiver.on_frame(frames[i], 220 * MS)
        assert (receiver.frames, receiver.copies, receiver.rejected) == ((4, 1), copies, rejected)


def test_frames_reduce_the_uncertainty_of_the_clock() -> None:
    certain_ns = []
    for every_ms in (5, 10_000):
        sender = Sender()
        receiver = joined(sender)
        for ms in range(101, 5_000):
            sender.serve(receiver, ms * MS)
            if ms % every_ms == 0:
                receiver.on_frame(sender.frame(ms * MS, 0.3), ms * MS)
        certain_ns.append(receiver.clock.uncertainty_ns(60_000 * MS))
    with_frames_ns, without_ns = certain_ns
    assert with_frames_ns < 0.9 * without_ns


def test_hello_is_the_first_message_over_a_new_connection() -> None:
    receiver = joined(sender := Sender())
    receiver.on_frame(sender.frame(500 * MS, 0.3), 500 * MS)
    receiver.introduce()
    assert isinstance(receiver.requests(500 * MS)[0], Hello)
    receiver.introduce()
    sent = [m for ms in range(501, 1000) for m in receiver.requests(ms * MS)]
    assert sum(isinstance(m, Hello) for m in sent) == 1


def test_many_frames_of_an_unknown_session_cause_one_hello() -> None:
    receiver = joined(sender := Sender())
    receiver.on_frame(sender.frame(200 * MS, 0.3), 200 * MS)
    stranger = Sender(session=8)
    hellos = 0
    for ms in range(400, 600):
        receiver.on_frame(stranger.frame(ms * MS, 0.3), ms * MS)
        hellos += sum(isinstance(r, Hello) for r in receiver.requests(ms * MS))
    assert hellos == 1
    assert receiver.rejected == {"session": 200}


def test_a_new_session_has_a_new_clock_and_keeps_the_old_account() -> None:
    receiver = joined(sender := Sender())
    for ms in range(100, 200, 5):
        receiver.on_frame(sender.frame(ms * MS, 0.3), ms * MS)
    receiver.buffer.advance(300 * MS + AHEAD_NS)
    assert receiver.account().played == 100
    again = Sender(session=8)
    receiver.on_control(encode_control(Welcome(8, 0, again.stream)), 300 * MS)
    assert not receiver.accepts_frames
    assert receiver.account().played == 100
    assert receiver.frames == (20, 0)
    receiver.on_control(encode_control(ClockReply(7, 0, AHEAD_NS, AHEAD_NS)), 301 * MS)
    assert receiver.rejected == {"session": 1}


@pytest.mark.parametrize(
    ("message", "cause"),
    [
        (encode_control(Hello("me")), "unexpected"),
        (encode_control(Bye(99, 5)), "session"),
        (encode_control(ClockReply(7, 500 * MS, 0, 0)), "unasked"),
        (b"\x93\x02", "truncated"),
        # There was no time for so many samples.
        (encode_control(Bye(7, 10**11)), "implausible"),
        (encode_control(Bye(7, 3)), "implausible"),
    ],
)
def test_a_bad_control_message_is_refused_under_its_cause(message: bytes, cause: str) -> None:
    receiver = joined(sender := Sender())
    receiver.on_frame(sender.frame(200 * MS, 0.3), 200 * MS)
    receiver.on_control(message, 210 * MS)
    assert receiver.rejected == {cause: 1}


def test_a_reply_with_impossible_times_is_refused() -> None:
    receiver = joined(sender := Sender())
    t1_ns = next(r.t1_ns for r in receiver.requests(120 * MS) if isinstance(r, ClockRequest))
    late_ns = t1_ns + AHEAD_NS + 1000 * MS
    reply = ClockReply(sender.session, t1_ns, late_ns, late_ns - 1)
    receiver.on_control(encode_control(reply), 121 * MS)
    assert receiver.rejected == {"implausible": 1}


def test_the_oldest_unanswered_requests_expire_and_a_clock_reply_counts_once() -> None:
    receiver = joined(sender := Sender())
    kept = []
    for ms in range(101, 20_000):
        if ms % 5 == 0:
            receiver.on_frame(sender.frame(ms * MS, 0.3), ms * MS)
        answers = [sender.answer(request, ms * MS) for request in receiver.requests(ms * MS)]
        kept += [data for data in answers if data is not None]
    for data in kept:
        receiver.on_control(data, 20_000 * MS)
    assert receiver.rejected == {"unasked": len(kept) - MAX_OPEN_REQUESTS}
    for _ in range(4):
        receiver.on_control(kept[-1], 20_000 * MS)
    assert receiver.rejected == {"unasked": len(kept) - MAX_OPEN_REQUESTS + 4}


@pytest.mark.parametrize("step_ms", [-3_600_000, 3_600_000])
def test_a_step_of_the_sensing_clock_costs_three_exchanges(step_ms: int) -> None:
    receiver = joined(sender := Sender())
    refused = 0
    for ms in range(101, 3000):
        stepped_ns = step_ms * MS if ms >= 1000 else 0
        if ms % 5 == 0:
            frame = sender.frame(ms * MS + stepped_ns, 0.3)
            refused += receiver.on_frame(frame, ms * MS) is None
        sender.serve(receiver, ms * MS, stepped_ns)
    assert (receiver.clock_steps, receiver.sessions, receiver.resets) == (1, 1, 2)
    assert receiver.ready
    # 3 exchanges 20 ms apart.
    assert 0 < refused <= 12
    receiver.buffer.advance(3000 * MS + AHEAD_NS + step_ms * MS)
    account = receiver.account()
    assert account.sent == sender.sent - account.before_joining
    assert account.played == account.sent - account.lost
    assert account.before_joining == 0


def test_a_small_step_is_followed_without_a_break() -> None:
    receiver = joined(sender := Sender())
    sender.serve(receiver, 101 * MS, until_ms=500)
    sender.serve(receiver, 500 * MS, 50 * MS, until_ms=1000)
    assert (receiver.clock_steps, receiver.resets) == (1, 1)
    assert receiver.clock.remote_ns(0) == AHEAD_NS + 50 * MS


@pytest.mark.parametrize("order", ["bye first", "bye last"])
def test_bye_is_returned_once_the_stream_is_complete(order: str) -> None:
    receiver = joined(sender := Sender())
    first, last = sender.frame(200 * MS, 0.3), sender.frame(205 * MS, 0.3)
    bye = encode_control(Bye(7, sender.sent))
    receiver.on_frame(first, 206 * MS)
    arrivals = [(receiver.on_control, bye), (receiver.on_frame, last)]
    for arrive, data in arrivals if order == "bye first" else reversed(arrivals):
        assert not any(isinstance(m, Bye) for m in receiver.requests(210 * MS))
        arrive(data, 210 * MS)
    sent = [m for ms in range(210, 500) for m in receiver.requests(ms * MS) if isinstance(m, Bye)]
    assert sent == [Bye(7, sender.sent)]


def test_a_display_that_leaves_before_the_end_sends_bye_unless_it_has_already() -> None:
    assert Receiver("test", [0], 0.01).leave() is None
    receiver = joined(sender := Sender())
    receiver.on_frame(sender.frame(200 * MS, 0.3), 201 * MS)
    bye = receiver.leave()
    assert bye is not None
    assert bye.session == 7
    # The end was reported, and is not confirmed yet.
    receiver.on_control(encode_control(Bye(7, sender.sent)), 210 * MS)
    assert receiver.leave() is not None
    assert [m for ms in range(210, 500) for m in receiver.requests(ms * MS) if isinstance(m, Bye)]
    assert receiver.leave() is None


@pytest.mark.parametrize("channel", [2, "c"])
def test_a_stream_without_a_wanted_channel_is_refused(channel: int | str) -> None:
    welcome = Welcome(7, 0, description(channels=(Channel("a"), Channel("b"))))
    receiver = Receiver("test", [0, channel], 0.01)
    receiver.on_control(encode_control(welcome), 0)
    assert receiver.rejected == {"channel": 1}
    assert receiver.description is None


@given(st.lists(st.binary(max_size=200), max_size=20))
def test_any_bytes_are_refused_and_counted(messages: list[bytes]) -> None:
    receiver = joined(Sender())
    for data in messages:
        receiver.on_frame(data, 200 * MS)
        receiver.on_control(data, 200 * MS)
    assert sum(receiver.rejected.values()) == 2 * len(messages)
