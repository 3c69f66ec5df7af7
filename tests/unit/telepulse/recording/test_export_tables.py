from base64 import b64encode

import numpy as np

from protocol.wire.messages import Frame, encode_frame
from telepulse.recording.export_tables import columns, rows
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import FRAME, TICK


def test_a_tick_of_several_contactors_has_the_forces_of_each() -> None:
    fields = {"now_ns": 5, "target_n": 0.1, "felt_n": 0.2}
    others = [{"target_n": 0.3, "felt_n": 0.4}, {"target_n": 0.5}]
    message = Entry(TICK, 7, fields | {"others": others})
    names = [column.name for column in columns(message)]
    (row,) = rows(message)
    by_name = dict(zip(names, row, strict=True))
    assert by_name["felt_n"] == 0.2
    assert (by_name["target_1_n"], by_name["felt_1_n"]) == (0.3, 0.4)
    # The felt force of the last one is unknown.
    assert (by_name["target_2_n"], by_name["felt_2_n"]) == (0.5, None)
    assert by_name["unix_ns"] == 7


def test_an_ecg_has_its_own_column_and_unit() -> None:
    data = encode_frame(Frame(1, 0, 5, 1_000_000, np.array([[0.5, -2.0]], "<f8")))
    fields = {"arrived_ns": 9, "path": 0, "data": b64encode(data).decode("ascii")}
    message = Entry(FRAME, 7, fields)
    header = columns(message, ["N", "mV"])
    (row,) = rows(message)
    by_name = {column.name: (column.unit, x) for column, x in zip(header, row, strict=True)}
    assert by_name["force_0_n"] == ("N", 0.5)
    assert by_name["ecg_1_mv"] == ("mV", -2.0)
