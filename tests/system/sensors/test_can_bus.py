import struct
import uuid
from contextlib import closing
from pathlib import Path

import can
import pytest

from protocol.errors import SourceError
from pulse_sensors.sensor import open_sensor
from tests.support.can_messages import (
    can_scene,
    film_message,
    udp_multicast_reason,
    write_database,
)
from tests.support.nodes import run_python
from tests.support.sample_blocks import forces, received

CHANNEL = "telepulse sensor test"
# A program with the bus of python-can, beside the sensing node: sends the film's forces.
SEND = """
import sys, time
import can
from tests.support.can_messages import film_message

with can.Bus(interface="udp_multicast", channel=sys.argv[1]) as bus:
    for number in range(int(sys.argv[2])):
        bus.send(film_message(number, number * 0.01))
        time.sleep(0.001)
"""


def test_a_signal_is_read_from_a_bus(tmp_path: Path) -> None:
    write_database(tmp_path)
    with (
        can.Bus(interface="virtual", channel=CHANNEL) as bus,
        closing(open_sensor(can_scene(CHANNEL, counter="Count"), tmp_path)) as sensor,
    ):
        bus.send(can.Message(arbitration_id=292, is_extended_id=False, data=bytes(2)))
        for number in range(20):
            bus.send(film_message(number, number * 0.01))
        assert forces(received(sensor, 20)) == pytest.approx([i * 0.01 for i in range(20)])
        assert (sensor.rejected, sensor.faults()) == ({}, [])


def test_several_signals_of_a_message_are_read_from_a_bus(tmp_path: Path) -> None:
    write_database(tmp_path)
    scene = can_scene(CHANNEL, signals=["Single", "Tick"], names=["cun", "announce"])
    with (
        can.Bus(interface="virtual", channel=CHANNEL) as bus,
        closing(open_sensor(scene, tmp_path)) as sensor,
    ):
        for number in range(20):
            data = struct.pack("<ff", number, -number)
            bus.send(can.Message(arbitration_id=295, is_extended_id=False, data=data))
        blocks = received(sensor, 20)
        assert [channel.unit for channel in sensor.channels] == ["N", "mV"]
    samples = [row for block in blocks for row in block.values.tolist()]
    assert samples == [[number, -number] for number in range(20)]


def test_another_process_sends_over_udp_multicast(tmp_path: Path) -> None:
    if (reason := udp_multicast_reason()) is not None:
        pytest.skip(f"udp_multicast: {reason}")
    write_database(tmp_path)
    group, count = f"239.74.163.{2 + uuid.uuid4().int % 200}", 200
    scene = can_scene(group, interface="udp_multicast", counter="Count")
    with closing(open_sensor(scene, tmp_path)) as sensor:
        sent = run_python("-c", f"import sys; sys.path.insert(0, '.')\n{SEND}", group, str(count))
        assert sent.returncode == 0, sent.stderr
        expected = [number * 0.01 for number in range(count)]
        assert forces(received(sensor, count)) == pytest.approx(expected, abs=1e-5)
        assert (sensor.rejected, sensor.faults()) == ({}, [])


@pytest.mark.parametrize(
    "keys", [{"interface": "guitar"}, {"interface": "socketcan", "channel": "can77"}]
)
def test_a_missing_bus_is_refused_in_one_line(tmp_path: Path, keys: dict[str, str]) -> None:
    write_database(tmp_path)
    with pytest.raises(SourceError, match="cannot be opened") as caught:
        open_sensor(can_scene(**keys), tmp_path)
    assert "\n" not in str(caught.value)
