import math
import struct
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import can
import pytest

from protocol.config.scene import validate
from protocol.errors import SourceError
from pulse_sensors.can_bus import CanDecoder, CanScene
from pulse_sensors.reading import Packet
from pulse_sensors.scene import open_sensor
from tests.support.lsl_listening import forces, heard

DBC = """VERSION ""
NS_ :
BS_:
BU_: Board Host
BO_ 291 Film: 4 Board
 SG_ Force : 0|16@1- (0.0001,0) [-3.2768|3.2767] "N" Host
 SG_ Count : 16|8@1+ (1,0) [0|255] "" Host
BO_ 292 Other: 2 Board
 SG_ Temperature : 0|16@1- (0.1,0) [-40|125] "C" Host
BO_ 294 Paged: 3 Board
 SG_ Page M : 0|8@1+ (1,0) [0|1] "" Host
 SG_ Squeeze m0 : 8|16@1- (0.0001,0) [-3.2768|3.2767] "N" Host
 SG_ Warmth m1 : 8|16@1- (0.1,0) [-40|125] "C" Host
BO_ 295 Floating: 8 Board
 SG_ Single : 0|32@1- (1,0) [0|0] "N" Host
 SG_ Tick : 32|32@1- (1,0) [0|0] "" Host
BO_ 293 Twin: 2 Board
 SG_ Temperature : 0|16@1- (0.1,0) [-40|125] "C" Host
SIG_VALTYPE_ 295 Single : 1;
SIG_VALTYPE_ 295 Tick : 1;
"""
CHANNEL = "telepulse sensor test"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "film.dbc").write_text(DBC, encoding="utf-8")
    return tmp_path


@pytest.fixture
def bus() -> Iterator[can.BusABC]:
    with can.Bus(interface="virtual", channel=CHANNEL) as bus:
        yield bus


def scene(channel: str = "none", **keys: object) -> CanScene:
    table = {
        **{"kind": "can", "interface": "virtual", "channel": channel, "database": "film.dbc"},
        **{"signal": "Force", "rate": "1 kHz", "unit": "N"},
    }
    return validate(table | keys, CanScene, "scene")


def message(number: int, force_n: float = 0.25, at_s: float | None = None) -> can.Message:
    data = round(force_n * 1e4).to_bytes(2, "little", signed=True) + bytes([number % 256, 0])
    when_s = 1e9 + number * 1e-3 if at_s is None else at_s
    return can.Message(when_s, arbitration_id=291, is_extended_id=False, data=data)


def test_a_signal_is_read_from_a_bus(bus: can.BusABC, folder: Path) -> None:
    with closing(open_sensor(scene(CHANNEL, counter="Count"), folder)) as sensor:
        bus.send(can.Message(arbitration_id=292, is_extended_id=False, data=bytes(2)))
        for number in range(20):
            bus.send(message(number, number * 0.01))
        assert forces(heard(sensor, 20)) == pytest.approx([i * 0.01 for i in range(20)])
        assert (sensor.rejected, sensor.faults()) == ({}, [])


def test_the_counter_tells_what_is_missing_and_turns_over(folder: Path) -> None:
    decoder = CanDecoder(scene(counter="Count"), folder)
    numbers = [*range(250, 262), *range(270, 275)]
    packets = [packet for number in numbers for packet in decoder.feed(message(number))]
    assert [packet.missing for packet in packets] == [0] * 12 + [8] + [0] * 4
    assert packets[0].anew
    assert packets[1] == Packet((0.25,), round((1e9 + 0.251) * 1e9))
    assert not decoder.rejected


def test_a_counter_that_jumps_without_the_time_is_counted(folder: Path) -> None:
    decoder = CanDecoder(scene(counter="Count"), folder)
    decoder.feed(message(0, at_s=100.0))
    assert decoder.feed(message(200, at_s=100.001))[0].missing == 0
    assert decoder.rejected == {"counter": 1}


@pytest.mark.parametrize("length", range(4))
def test_a_short_message_is_counted(folder: Path, length: int) -> None:
    decoder = CanDecoder(scene(), folder)
    short = can.Message(1.0, arbitration_id=291, is_extended_id=False, data=bytes(length))
    assert decoder.feed(short) == []
    assert decoder.rejected == {"not_decoded": 1}


def test_a_message_with_another_page_is_no_sample_and_no_error(folder: Path) -> None:
    decoder = CanDecoder(scene(signal="Squeeze"), folder)
    pages = [
        can.Message(
            1.0 + page, arbitration_id=294, is_extended_id=False, data=bytes([page, 100, 0])
        )
        for page in (0, 1)
    ]
    assert [packet.values for page in pages for packet in decoder.feed(page)] == [(0.01,)]
    assert not decoder.rejected


@pytest.mark.parametrize(
    ("force_n", "tick", "cause"),
    [(math.nan, 0, "not_finite"), (1e31, 0, "not_finite"), (0, math.nan, "not_decoded")],
)
def test_floats_that_are_no_numbers_are_counted(
    folder: Path, force_n: float, tick: float, cause: str
) -> None:
    decoder = CanDecoder(scene(signal="Single", counter="Tick"), folder)
    data = struct.pack("<ff", force_n, tick)
    told = can.Message(1.0, arbitration_id=295, is_extended_id=False, data=data)
    assert decoder.feed(told) == []
    assert decoder.rejected == {cause: 1}


def test_an_error_on_the_bus_is_counted(folder: Path) -> None:
    decoder = CanDecoder(scene(), folder)
    assert decoder.feed(can.Message(is_error_frame=True)) == []
    assert decoder.rejected == {"bus_error": 1}


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (
            {"signal": "Pulse"},
            "no signal 'Pulse'; it has Force, Count, Temperature, Page, Squeeze, ",
        ),
        ({"unit": "mN"}, '\'Force\' is in N, the scene says unit = "mN"; set unit = "N"'),
        ({"unit": "V"}, '\'Force\' is in N, the scene says unit = "V"; set unit = "N"'),
        ({"counter": "Tick"}, "Film has no signal 'Tick'; it has Force, Count"),
        ({"message": "Fil"}, "no message 'Fil'; it has Film, Other, Paged, Floating, Twin"),
        ({"signal": "Temperature"}, "'Temperature' is in Other, Twin; say which: message"),
        ({"database": "none.dbc"}, "no such database"),
        ({"database": "bad.dbc"}, "cannot be read: "),
    ],
)
def test_a_database_without_the_signal_is_one_line(
    folder: Path, keys: dict[str, object], said: str
) -> None:
    (folder / "bad.dbc").write_bytes(b"\xff\x00 no database")
    with pytest.raises(SourceError) as caught:
        open_sensor(scene(**keys), folder)
    assert said in str(caught.value)
    assert str(caught.value).startswith(str(folder))
    assert "\n" not in str(caught.value)


def test_a_message_may_be_named_where_several_have_the_signal(folder: Path) -> None:
    assert CanDecoder(scene(signal="Temperature", message="Twin"), folder).frame_id == 293


@pytest.mark.parametrize(
    "keys", [{"interface": "guitar"}, {"interface": "socketcan", "channel": "can77"}]
)
def test_a_bus_that_is_not_there_is_one_line(folder: Path, keys: dict[str, object]) -> None:
    with pytest.raises(SourceError, match="cannot be opened") as caught:
        open_sensor(scene(**keys), folder)
    assert "\n" not in str(caught.value)
