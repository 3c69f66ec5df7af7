"""An emulated slcan adapter, by its lines and through python-can's own interface."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

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
def test_a_line_is_a_frame_and_the_other_way_round(
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
def test_what_is_no_line_is_answered_by_a_bell_and_harms_nothing(line: bytes) -> None:
    adapter = opened()
    assert adapter.feed(line + b"\r") == (b"\a", [])
    assert adapter.refused == 1
    assert adapter.feed(b"t0800\r")[0] == b"z\r"


def test_while_closed_nothing_passes() -> None:
    adapter = SlcanAdapter()
    assert adapter.feed(b"t0800\r") == (b"\a", [])
    assert adapter.encode(can.Message(arbitration_id=1, is_extended_id=False)) == b""


@given(st.lists(st.binary(max_size=2 * LONGEST), max_size=8))
def test_no_bytes_break_it(chunks: list[bytes]) -> None:
    adapter = opened()
    for chunk in chunks:
        adapter.feed(chunk)
    assert len(adapter._line) <= LONGEST + 1
    adapter.feed(b"\r")
    assert adapter.feed(b"V\r")[0] == b"V1013\r"


@pytest.fixture
def far_end() -> Iterator[SlcanBus]:
    with SlcanBus(PtyPort(None)) as bus:
        yield bus


def test_a_sensor_is_read_through_it(far_end: SlcanBus, tmp_path: Path) -> None:
    (tmp_path / "film.dbc").write_text(DATABASE, encoding="utf-8")
    options = {"sleep_after_open": 0.0}
    channel = far_end.channel_info.split()[1]
    table = can_scene(channel, interface="slcan", bitrate=500_000, counter="Count", options=options)
    with closing(open_sensor(table, tmp_path)) as sensor:
        until(lambda: far_end.recv(0.01) is None and far_end._adapter.is_open)
        for number in range(20):
            far_end.send(film_message(number, number * 0.01))
        assert forces(received(sensor, 20)) == pytest.approx([i * 0.01 for i in range(20)])
        assert (sensor.rejected, sensor.faults()) == ({}, [])


def test_noise_from_an_adapter_is_named_and_the_sensor_comes_back(
    far_end: SlcanBus, tmp_path: Path, logged: list[str]
) -> None:
    """python-can's interface fails at it; the sensor opens the adapter anew."""
    (tmp_path / "film.dbc").write_text(DATABASE, encoding="utf-8")
    channel = far_end.channel_info.split()[1]
    table = can_scene(channel, interface="slcan", options={"sleep_after_open": 0.0})
    with closing(open_sensor(table, tmp_path)) as sensor:
        until(lambda: far_end.recv(0.01) is None and far_end._adapter.is_open)
        far_end._port.write(b"t12\xff\xfe\r")

        def back() -> bool:
            sensor.poll()
            far_end.recv(0.01)
            return len(logged) >= 2

        until(back)
        assert "has gone" in logged[0]
        assert "is back" in logged[1]
        until(lambda: far_end.recv(0.01) is None and far_end._adapter.is_open)
        far_end.send(film_message(1, 0.5))
        assert forces(received(sensor, 1)) == pytest.approx([0.5])
