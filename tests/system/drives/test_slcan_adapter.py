"""An emulated slcan adapter, by its lines and through python-can's own interface."""

from contextlib import closing
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pulse_sensors.sensor import open_sensor
from telepulse.emulators import PtyPort
from telepulse.emulators.slcan import LONGEST, SlcanAdapter, SlcanBus
from tests.support.can_messages import DATABASE, can_scene, film_message
from tests.support.sample_blocks import forces, received
from tests.support.waiting import until

GIVE_UP_S = 10.0


def opened() -> SlcanAdapter:
    adapter = SlcanAdapter()
    assert adapter.feed(b"C\r\rS8\rO\r") == (b"\r\r\r\r", [])
    return adapter


@pytest.mark.parametrize(
    ("line", "answer", "identifier", "data"),
    [
        (b"t2016", b"z", 0x201, bytes.fromhex("0F0010270000")),
        (b"t0800", b"z", 0x80, b""),
        (b"T1FFFFFFF1", b"Z", 0x1FFF_FFFF, b"\xaa"),
        (b"r7010", b"z", 0x701, b""),
    ],
)
def test_lines_are_decoded_and_encoded(
    line: bytes, answer: bytes, identifier: int, data: bytes
) -> None:
    adapter = opened()
    line += data.hex().upper().encode() + b"\r"
    answered, frames = adapter.feed(line)
    assert answered == answer + b"\r"
    assert [(frame.arbitration_id, bytes(frame.data)) for frame in frames] == [(identifier, data)]
    assert adapter.encode(frames[0]) == line


@pytest.mark.parametrize(
    "line",
    [b"t20160F", b"t2019", b"tXYZ0", b"t8000", b"Q", b"S9", b"S8", b"OO", b"t", b"\xff", b"t" * 99],
)
def test_an_invalid_line_is_refused_by_a_bell(line: bytes) -> None:
    adapter = opened()
    assert adapter.feed(line + b"\r") == (b"\a", [])
    assert adapter.refused == 1
    assert adapter.feed(b"t0800\r")[0] == b"z\r"


def test_a_closed_channel_passes_no_frames() -> None:
    adapter = SlcanAdapter()
    assert adapter.feed(b"t0800\r") == (b"\a", [])
    assert adapter.encode(can.Message(arbitration_id=1, is_extended_id=False)) == b""


@given(st.lists(st.binary(max_size=2 * LONGEST), max_size=8))
def test_any_bytes_are_accepted_in_bounded_memory(chunks: list[bytes]) -> None:
    adapter = opened()
    for chunk in chunks:
        adapter.feed(chunk)
    assert len(adapter._line) <= LONGEST + 1
    adapter.feed(b"\r")
    assert adapter.feed(b"V\r")[0] == b"V1013\r"


def test_a_sensor_is_read_through_the_adapter_and_opens_it_anew_after_noise(
    tmp_path: Path, logged: list[str]
) -> None:
    """python-can's interface fails at noise."""
    (tmp_path / "film.dbc").write_text(DATABASE, encoding="utf-8")
    with SlcanBus(PtyPort(None)) as far_end:
        channel, options = far_end.channel_info.split()[1], {"sleep_after_open": 0.0}
        keys: dict[str, Any] = {"interface": "slcan", "bitrate": 500_000, "options": options}
        with closing(open_sensor(can_scene(channel, counter="Count", **keys), tmp_path)) as sensor:
            until(lambda: far_end.recv(0.01) is None and far_end._adapter.is_open)
            for number in range(20):
                far_end.send(film_message(number, number * 0.01))
            assert forces(received(sensor, 20)) == pytest.approx([i * 0.01 for i in range(20)])
            assert (sensor.rejected, sensor.faults()) == ({}, [])
            far_end._port.write(b"t12\xff\xfe\r")

            def back() -> bool:
                sensor.poll()
                far_end.recv(0.01)
                return len(logged) >= 2

            until(back)
            assert "has gone" in logged[0]
            assert "is back" in logged[1]
            until(lambda: far_end.recv(0.01) is None and far_end._adapter.is_open)
            far_end.send(film_message(20, 0.5))
            assert forces(received(sensor, 1)) == pytest.approx([0.5])
