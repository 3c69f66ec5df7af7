import itertools
import threading
from collections import Counter
from contextlib import closing

import pytest

from protocol.config.scene import validate
from protocol.errors import SourceError
from pulse_sensors import sensor as module
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.samples import DecodedBlock, decoded_block
from pulse_sensors.sensor import Sensor
from tests.support.sample_blocks import forces, received
from tests.support.waiting import until

TABLE = validate({"rate": "1 kHz", "unit": "N"}, SensorTable, "scene")


class GivenPort:
    """A port with given values to read, or errors to raise."""

    name = "the port"

    def __init__(self, *given: object, opens: int = 2) -> None:
        self._given = list(given)
        self._opens = opens
        self.openings = 0
        self.empty = threading.Event()

    def open(self) -> None:
        self.openings += 1
        if self.openings > self._opens:
            raise SourceError("not now")

    def read(self) -> object:
        if not self._given:
            self.empty.wait(0.01)
            self.empty.set()
            return None
        given = self._given.pop(0)
        if isinstance(given, Exception):
            raise given
        return given

    def close(self) -> None:
        pass


class AsIs:
    """A decoder that returns each value unchanged."""

    def __init__(self) -> None:
        self.rejected: Counter[str] = Counter()
        self.resets = 0

    def feed(self, data: float) -> list[DecodedBlock]:
        return [decoded_block([data])]

    def reset(self) -> None:
        self.resets += 1


@pytest.fixture(autouse=True)
def reopened_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REOPEN_EVERY_S", 0.001)


@pytest.mark.parametrize("error", [OSError("pulled"), TypeError("driver"), RuntimeError("driver")])
def test_after_any_driver_error_the_device_is_reopened(error: Exception, logged: list[str]) -> None:
    port, decoder = GivenPort(0.1, error, 0.2), AsIs()
    with closing(Sensor(port, decoder, TABLE)) as sensor:
        assert forces(received(sensor, 2)) == [0.1, 0.2]
    assert logged == [f"the port has gone: {error}", "the port is back"]
    assert (port.openings, decoder.resets) == (2, 1)


def test_a_missing_device_is_retried_until_closed() -> None:
    port = GivenPort(OSError("pulled"), opens=1)
    with closing(Sensor(port, AsIs(), TABLE)) as sensor:
        until(lambda: port.openings > 5)
        assert sensor.poll() == []
        gone, never = sensor.faults()
        assert never == "no sample came from the port"
        assert gone.startswith("the port was gone 1 time, for ")


def test_data_that_are_not_polled_are_dropped_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_WAITING", 10)
    port = GivenPort(*range(1, 26))
    with closing(Sensor(port, AsIs(), TABLE)) as sensor:
        until(port.empty.is_set)
        assert len(sensor.poll()) == 10
        assert sensor.rejected == {"backlog": 15}
        assert sensor.poll() == []


def test_a_wrong_rate_is_logged_once_while_the_sensor_runs(logged: list[str]) -> None:
    arrival_ns = itertools.count(0, 2_000_000)
    with closing(Sensor(GivenPort(*range(1, 3001)), AsIs(), TABLE, arrival_ns.__next__)) as sensor:
        received(sensor, 2000)
        fault = "the port sends 500 Hz, the scene says 1000 Hz: check its rate"
        assert logged == [fault]
        assert sensor.faults()[-1] == fault
