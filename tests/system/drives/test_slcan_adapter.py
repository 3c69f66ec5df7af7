"""A sensor on the CAN bus behind an slcan adapter, through python-can's own interface."""

from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from pulse_sensors.sensor import open_sensor
from telepulse.emulators import PtyPort
from tests.support.can_messages import DATABASE, can_scene, film_message
from tests.support.sample_blocks import forces, received
from tests.support.slcan import SlcanBus
from tests.support.waiting import until


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
