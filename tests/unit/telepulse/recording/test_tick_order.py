import json
from collections.abc import Iterable

from telepulse.recording import reader as module
from telepulse.recording.reader import RecordedMessage, in_tick_order
from telepulse.telemetry.schema import CLOCK, EVENT, FRAME, TICK


def message(topic: str, **fields: int) -> RecordedMessage:
    return RecordedMessage(topic, 0, json.dumps(fields).encode())


def told(messages: Iterable[RecordedMessage]) -> list[tuple[str, int]]:
    return [(each.topic, next(iter(each.fields.values()), 0)) for each in in_tick_order(messages)]


def test_a_received_message_comes_before_the_next_due_tick() -> None:
    published = [
        message(FRAME, arrived_ns=5),
        message(CLOCK, t4_ns=20),
        message(FRAME, arrived_ns=99),
        message(EVENT),
        *(message(TICK, now_ns=now_ns) for now_ns in (4, 5, 21)),
    ]
    assert told(published) == [
        (EVENT, 0),
        (TICK, 4),
        (FRAME, 5),
        (TICK, 5),
        (CLOCK, 20),
        (TICK, 21),
        (FRAME, 99),
    ]


def test_without_ticks_little_waits() -> None:
    heard = (message(FRAME, arrived_ns=number) for number in range(module.MAX_WAITING + 500))
    turns = in_tick_order(heard)
    assert next(turns).fields["arrived_ns"] == 0
    assert next(heard).fields["arrived_ns"] == module.MAX_WAITING + 1
    assert len(list(turns)) == module.MAX_WAITING + 498
