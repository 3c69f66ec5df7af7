"""A recording's messages in the order in which the display had them. Pure."""

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from telepulse.recording.reader import RecordedMessage
from telepulse.telemetry.schema import CLOCK, FRAME, REFUSED, STREAM, TICK

# When each was heard, on the display's clock.
_HEARD = {FRAME: "arrived_ns", STREAM: "arrived_ns", REFUSED: "arrived_ns", CLOCK: "t4_ns"}
# What is heard without a tick after it.
MAX_WAITING = 10_000


class TimedMessage(NamedTuple):
    """A message: topic, Unix time, fields."""

    topic: str
    t_ns: int
    fields: dict[str, Any]


def in_turn(messages: Iterable[RecordedMessage]) -> Iterator[TimedMessage]:
    """Ticks are published by twenties, what was heard meanwhile before them: here each message
    stands before the first tick that was due after it came.

    Raises KeyError or ValueError where a message is not telepulse's.
    """
    waiting: deque[tuple[int, TimedMessage]] = deque()
    for message in messages:
        told = TimedMessage(message.topic, message.t_ns, message.fields)
        if told.topic in _HEARD:
            waiting.append((told.fields[_HEARD[told.topic]], told))
            if len(waiting) > MAX_WAITING:
                yield waiting.popleft()[1]
            continue
        if told.topic == TICK:
            while waiting and waiting[0][0] <= told.fields["now_ns"]:
                yield waiting.popleft()[1]
        yield told
    yield from (told for _, told in waiting)
