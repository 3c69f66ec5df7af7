import itertools
from collections.abc import Iterator

import msgpack
import pytest

from protocol.errors import WireError
from protocol.summary.fields import SampleCounts, Summary
from protocol.wire.messages import MAX_FRAME_BYTES
from protocol.wire.telemetry import (
    CONTROL,
    MAX_KEPT_BYTES,
    SUBSCRIBED,
    UNSUBSCRIBED,
    CapturedMessage,
    CapturedMessages,
    CaptureWriter,
    PlaybackStatus,
    pack_status,
    read_capture,
    read_status,
)

MAX_SOCKET_BYTES = 4 * MAX_FRAME_BYTES


def wanted() -> CaptureWriter:
    writer = CaptureWriter(run=9)
    writer.follow(SUBSCRIBED)
    return writer


def taken(writer: CaptureWriter) -> list[CapturedMessages]:
    return [read_capture(message) for message in writer.take(100, 2_000)]


def messages_of(parts: list[CapturedMessages]) -> Iterator[CapturedMessage]:
    for part in parts:
        yield from part.messages


def test_a_capture_has_every_message_with_its_time_and_path() -> None:
    writer = wanted()
    writer.traces_published, writer.statuses_published = 5, 2
    writer.add(1, 0, b"a")
    writer.add(2, CONTROL, b"")
    (captured,) = taken(writer)
    assert captured == CapturedMessages(
        9, 100, 2_000, 5, 2, 0, [CapturedMessage(1, 0, b"a"), CapturedMessage(2, CONTROL, b"")]
    )
    assert taken(writer) == [CapturedMessages(9, 100, 2_000, 5, 2, 2, [])]


def test_messages_without_a_subscriber_are_counted_only() -> None:
    writer = CaptureWriter(run=9)
    writer.follow(b"\1")
    writer.follow(b"\1trace")
    writer.add(1, 0, b"a")
    assert not writer.wanted
    writer.follow(SUBSCRIBED)
    writer.add(2, 0, b"b")
    writer.follow(UNSUBSCRIBED)
    writer.add(3, 0, b"c")
    writer.follow(SUBSCRIBED)
    writer.add(4, 0, b"d")
    (captured,) = taken(writer)
    assert (captured.before, captured.messages) == (3, [CapturedMessage(4, 0, b"d")])


def test_a_message_above_a_frames_limit_is_cut() -> None:
    writer = wanted()
    writer.add(1, 0, bytes(3 * MAX_FRAME_BYTES))
    (message,) = messages_of(taken(writer))
    assert len(message.data) == MAX_FRAME_BYTES + 1


def test_a_flood_is_split_for_the_socket_and_beyond_a_limit_counted_only() -> None:
    writer, count = wanted(), 200
    for number in range(count):
        writer.add(number, 0, bytes(MAX_FRAME_BYTES))
    parts = list(writer.take(100, 2_000))
    assert all(len(part) < MAX_SOCKET_BYTES for part in parts)
    captured = [read_capture(part) for part in parts]
    kept = list(messages_of(captured))
    assert MAX_KEPT_BYTES // MAX_FRAME_BYTES <= len(kept) < count
    assert [message.arrived_ns for message in kept] == list(range(len(kept)))
    for one, other in itertools.pairwise(captured):
        assert other.before == one.before + len(one.messages)
    writer.add(count, 0, b"after")
    (after,) = taken(writer)
    assert (after.before, after.messages) == (count, [CapturedMessage(count, 0, b"after")])


@pytest.mark.parametrize(
    "value",
    [
        [1, 2, 3, 4, 5, 6], [1, 2, 3, 4, 5, "6", []], [1, 2, 3, 4, 5, 6, [[1, 2]]],
        [1, 2, 3, 4, 5, 6, [[1, 2, "text"]]], [1, 2, 3, 4, 5, 6, [[1, None, b""]]],
        [1, 2, 3, 4, 5, True, []], None, {},
    ],
)  # fmt: skip
def test_an_invalid_capture_is_refused(value: object) -> None:
    with pytest.raises(WireError):
        read_capture(msgpack.packb(value))


SUMMARY = Summary(samples=SampleCounts(sent=5))


def test_a_sensing_nodes_status_is_decoded_as_it_was_encoded() -> None:
    status = read_status(pack_status("streaming", "pulse", SUMMARY, False, 2**62, displays=3))
    assert (status.state, status.stream, status.final) == ("streaming", "pulse", False)
    assert (status.session, status.displays) == (2**62, 3)
    assert status.summary == SUMMARY.to_dict()


def test_a_displays_status_has_its_playback() -> None:
    playing = [
        PlaybackStatus("cun", 1, 0.5, -4.8e-6, "stack", 60_000_000),
        PlaybackStatus("chi", 0, 1.0, -4.8e-6, "stack", 60_000_000),
    ]
    status = read_status(pack_status("playing", "pulse", SUMMARY, False, 7, playing=playing))
    assert status.playing == playing


@pytest.mark.parametrize(
    "more",
    [
        [1], [1, 2], [1, 2, 3], ["1", 2, []], [1, 2.0, []], [True, 1, []], [{}, [], []],
        [1, 2, None], [1, 2, ["a", 0, 1.0, -1.0, "stack", 60]],
        [1, 2, [["a", 0, 1.0, -1.0, "stack"]]], [1, 2, [["a", 0, 1.0, -1.0, 5, 60]]],
        [1, 2, [["a\n", 0, 1.0, -1.0, "stack", 60]]], [1, 2, [["", 0, 1.0, -1.0, "stack", 60]]],
        [1, 2, [["a", 0, float("nan"), -1.0, "stack", 60]]], [1, 2, [{"channel": 0}]],
        [1, 2, [["a", 0, 1.0, -1.0, "stack", 60], ["a", 1, 1.0, -1.0, "stack", 60]]],
    ],
)  # fmt: skip
def test_an_invalid_status_is_refused(more: list[object]) -> None:
    with pytest.raises(WireError):
        read_status(msgpack.packb(["playing", "pulse", {}, False, *more]))
