from contextlib import closing
from pathlib import Path

import can
import pytest

from protocol.errors import SourceError
from pulse_sensors.sensor import open_sensor
from tests.support.can_messages import (
    can_scene,
    film_message,
    write_database,
)
from tests.support.refusals import refusal_of
from tests.support.sample_blocks import forces, received

CHANNEL = "telepulse sensor test"


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


@pytest.mark.parametrize(
    "keys", [{"interface": "guitar"}, {"interface": "socketcan", "channel": "can77"}]
)
def test_a_missing_bus_is_refused_in_one_line(tmp_path: Path, keys: dict[str, str]) -> None:
    write_database(tmp_path)
    assert "cannot be opened" in refusal_of(SourceError, open_sensor, can_scene(**keys), tmp_path)
