import json

from telepulse.recording.export import columns, rows
from telepulse.recording.reader import RecordedMessage
from telepulse.telemetry.schema import TICK


def test_a_tick_of_several_contactors_has_the_forces_of_each() -> None:
    fields = {"now_ns": 5, "target_n": 0.1, "felt_n": 0.2}
    others = [{"target_n": 0.3, "felt_n": 0.4}, {"target_n": 0.5}]
    message = RecordedMessage(TICK, 7, json.dumps(fields | {"others": others}).encode())
    names = [column.name for column in columns(message)]
    (row,) = rows(message)
    by_name = dict(zip(names, row, strict=True))
    assert by_name["felt_n"] == 0.2
    assert (by_name["target_1_n"], by_name["felt_1_n"]) == (0.3, 0.4)
    # The felt force of the last one is unknown.
    assert (by_name["target_2_n"], by_name["felt_2_n"]) == (0.5, None)
    assert by_name["unix_ns"] == 7
