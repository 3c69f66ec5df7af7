"""Record of all that the display receives, for a recorder: every message as it came, and when.

Published as telemetry under a topic of its own, "heard", beside every trace and only while
somebody has asked for it. Each message says how much was published before it, so that a reader
knows what it has missed.
"""

from collections.abc import Iterator
from typing import NamedTuple

import msgpack

from display_node.telemetry.messages import unpack
from protocol.errors import WireError
from protocol.wire.messages import MAX_FRAME_BYTES, TIME_RANGE

HEARD = b"heard"
CONTROL = -1
# What a message costs beside its bytes.
OVERHEAD_BYTES = 64
# Sockets take four times a frame's greatest size.
MAX_PART_BYTES = 2 * MAX_FRAME_BYTES
MAX_PART_MESSAGES = MAX_PART_BYTES // OVERHEAD_BYTES + 1
# Between two traces; of a flood beyond it, messages are counted, not kept.
MAX_KEPT_BYTES = 64 * MAX_FRAME_BYTES
SUBSCRIBED, UNSUBSCRIBED = b"\1" + HEARD, b"\0" + HEARD


class CapturedMessage(NamedTuple):
    """One message from the sensing node: when it came, on the display's clock; which of the data
    connections it came over, or CONTROL; its bytes, cut where they are above a frame's limit."""

    arrived_ns: int
    path: int
    data: bytes


class CapturedMessages(NamedTuple):
    """Consecutive messages, and where they stand in what a display's run publishes.

    run: a random number of this run. now_ns, wall_ns: one instant on the display's clock and in
    Unix time. traces, statuses: published so far. before: messages heard before these.
    """

    run: int
    now_ns: int
    wall_ns: int
    traces: int
    statuses: int
    before: int
    messages: list[CapturedMessage]


class CaptureWriter:
    """Collects what is heard, while somebody wants it, and gives it out as messages."""

    def __init__(self, run: int) -> None:
        self._run = run
        self._heard = self._first = 0
        self._messages: list[CapturedMessage] = []
        self._kept_bytes = 0
        self._welcome: CapturedMessage | None = None
        self.wanted = False
        self.traces = self.statuses = 0

    def follow(self, subscription: bytes) -> None:
        """A reader came, or the last one left: what an XPUB socket tells."""
        if subscription == SUBSCRIBED:
            self.wanted = True
            # Who comes late must know the stream as well.
            if self._welcome is not None:
                self._keep(self._welcome)
        elif subscription == UNSUBSCRIBED:
            self.wanted = False
            self._messages.clear()
            self._kept_bytes = 0

    def add(self, arrived_ns: int, path: int, data: bytes) -> None:
        """A message came."""
        if self.wanted and self._kept_bytes < MAX_KEPT_BYTES:
            self._keep(CapturedMessage(arrived_ns, path, data[: MAX_FRAME_BYTES + 1]))
        else:
            self._heard += 1

    def welcome(self, arrived_ns: int, data: bytes) -> None:
        """The message that came described the stream; it is said again to who comes later."""
        self._welcome = CapturedMessage(arrived_ns, CONTROL, data)

    def take(self, now_ns: int, wall_ns: int) -> Iterator[bytes]:
        """Yield the messages kept since the last call, in one telemetry message or several."""
        kept, self._messages, self._kept_bytes = self._messages, [], 0
        before = self._first if kept else self._heard
        while True:
            part = _up_to(kept, MAX_PART_BYTES)
            head = (self._run, now_ns, wall_ns, self.traces, self.statuses, before)
            yield msgpack.packb((*head, part))
            before += len(part)
            kept = kept[len(part) :]
            if not kept:
                return

    def _keep(self, message: CapturedMessage) -> None:
        if not self._messages:
            self._first = self._heard
        self._heard += 1
        self._kept_bytes += len(message.data) + OVERHEAD_BYTES
        self._messages.append(message)


def _up_to(messages: list[CapturedMessage], limit_bytes: int) -> list[CapturedMessage]:
    """The first messages, one at least, that are together below a limit."""
    size = 0
    for count, message in enumerate(messages):
        size += len(message.data) + OVERHEAD_BYTES
        if size > limit_bytes and count:
            return messages[:count]
    return messages


def read_capture(data: bytes) -> CapturedMessages:
    """Decode a message of received messages. Raises WireError."""
    try:
        *head, messages = unpack(data, MAX_PART_MESSAGES)
        heard = CapturedMessages._make((*head, [CapturedMessage(*message) for message in messages]))
    except (ValueError, TypeError) as error:
        raise WireError("malformed", f"not what was heard: {error}") from None
    numbers: list[object] = [
        *head,
        *(number for message in heard.messages for number in message[:2]),
    ]
    texts = [message.data for message in heard.messages]
    if not (all(type(n) is int for n in numbers) and all(type(t) is bytes for t in texts)):
        raise WireError("malformed", "a field of what was heard has the wrong type")
    if not all(number in TIME_RANGE for number in numbers):
        raise WireError("malformed", "a number of what was heard is out of range")
    return heard
