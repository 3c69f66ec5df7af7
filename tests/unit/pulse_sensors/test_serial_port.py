import errno
import os
from collections.abc import Callable
from contextlib import closing
from typing import Any

import pytest
import serial
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from protocol.config.scene import validate
from protocol.errors import SourceError
from pulse_sensors.sensor import Sensor
from pulse_sensors.serial_port import SerialPort, SerialScene
from tests.support.refusals import refusal_of
from tests.support.sample_blocks import forces, received
from tests.support.waiting import until

NAME = "/dev/ttyACM0"
UNO, OTHER_UNO, NANO = (0x2341, 0x43, "85436"), (0x2341, 0x43, "95437"), (0x1A86, 0x7523, None)
NO_SERIAL_NUMBER = "no serial number"


def scene() -> SerialScene:
    keys = {"kind": "serial", "port": NAME, "framing": "text", "rate": "1 kHz", "unit": "N"}
    return validate(keys, SerialScene, "scene")


def listed(name: str, usb: tuple[int, int, str | None] | None = None) -> ListPortInfo:
    port = ListPortInfo(name)
    if usb is not None:
        port.vid, port.pid, port.serial_number = usb
    return port


class Line:
    """A port as pyserial gives it, without a descriptor; gone: is called before it raises."""

    def __init__(self, *data: bytes | Exception, gone: Callable[[], None] | None = None) -> None:
        self._data, self._gone = list(data), gone
        self.closed = False

    def read(self, size: int) -> bytes:
        data = self._data.pop(0) if self._data and size else b""
        if isinstance(data, Exception):
            if self._gone is not None:
                self._gone()
            raise data
        return data

    in_waiting = 0

    def close(self) -> None:
        self.closed = True


class Machine:
    """The ports that are there, and what opening one gives."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.ports: list[ListPortInfo] = []
        self.gives: Any = Line()
        monkeypatch.setattr(list_ports, "comports", lambda: list(self.ports))
        monkeypatch.setattr(serial, "serial_for_url", self._open)

    def _open(self, *_: object, **__: object) -> Line:
        if isinstance(self.gives, Exception):
            raise self.gives
        return self.gives


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    return Machine(monkeypatch)


def failure(number: int) -> serial.SerialException:
    return serial.SerialException(number, "could not open port")


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.ENOENT, ""),
        (errno.EBUSY, "; another program uses it"),
        (errno.EAGAIN, "; another program uses it"),
        (errno.EACCES, "; this user may not open it"),
    ],
)
def test_why_a_port_cannot_be_opened_is_named_by_its_cause(
    machine: Machine, number: int, advice: str
) -> None:
    machine.gives, machine.ports = failure(number), [listed("/dev/ttyS1"), listed("/dev/ttyS0")]
    line = refusal_of(SourceError, SerialPort(scene()).open)
    assert line.startswith(f"{NAME}: cannot be opened: {os.strerror(number)}{advice}")
    assert line.endswith("; ports here: /dev/ttyS0, /dev/ttyS1")
    assert ("uses it" in line, "may not" in line) == ("uses it" in advice, "may not" in advice)


@pytest.mark.parametrize(
    ("usb", "words"),
    [
        (UNO, "the same device (USB 2341:0043, serial number 85436) is now /dev/ttyACM1"),
        (OTHER_UNO, None),
        (NANO, None),
        (None, None),
    ],
)
def test_a_device_that_is_back_under_another_name_is_named(
    machine: Machine, usb: tuple[int, int, str | None] | None, words: str | None
) -> None:
    port = SerialPort(scene())
    machine.ports = [listed(NAME, UNO), listed("/dev/ttyS0")]
    port.open()
    port.close()
    machine.gives = failure(errno.ENOENT)
    machine.ports = [listed("/dev/ttyACM1", usb), listed("/dev/ttyS0")]
    line = refusal_of(SourceError, port.open)
    assert "ports here: /dev/ttyACM1, /dev/ttyS0" in line
    assert "is now" not in line if words is None else words in line
    # Nobody else's port is opened in its place.
    assert line.startswith(f"{NAME}: cannot be opened: {os.strerror(errno.ENOENT)}; ")


def test_of_devices_without_serial_numbers_only_one_that_is_new_may_be_it(
    machine: Machine,
) -> None:
    port = SerialPort(scene())
    machine.ports = [listed(NAME, NANO), listed("/dev/ttyUSB7", NANO)]
    port.open()
    machine.gives, machine.ports = failure(errno.ENOENT), [listed("/dev/ttyUSB7", NANO)]
    assert "is now" not in refusal_of(SourceError, port.open)
    machine.ports = [listed("/dev/ttyUSB7", NANO), listed("/dev/ttyUSB8", NANO)]
    line = refusal_of(SourceError, port.open)
    assert "the same device (USB 1A86:7523, without a serial number) is now /dev/ttyUSB8" in line


def test_another_device_of_the_same_name_is_refused(machine: Machine) -> None:
    port = SerialPort(scene())
    machine.ports = [listed(NAME, UNO)]
    port.open()
    port.close()
    machine.gives, machine.ports = Line(), [listed(NAME, NANO), listed("/dev/ttyACM1", UNO)]
    line = refusal_of(SourceError, port.open)
    assert line.startswith(
        f"{NAME}: another device is there, USB 1A86:7523, without a serial number; the sensor, USB"
        " 2341:0043, serial number 85436, is now /dev/ttyACM1"
    )
    assert machine.gives.closed
    machine.gives, machine.ports = Line(), [listed(NAME, UNO)]
    port.open()


def test_a_system_that_cannot_list_its_ports_has_a_sensor_all_the_same(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail() -> None:
        raise OSError("no list")

    monkeypatch.setattr(list_ports, "comports", fail)
    port = SerialPort(scene())
    port.open()
    machine.gives = failure(errno.ENOENT)
    assert refusal_of(SourceError, port.open).endswith("ports here: none")


def test_a_sensor_says_once_why_its_port_is_gone_and_finds_it_again(
    machine: Machine, monkeypatch: pytest.MonkeyPatch, logged: list[str]
) -> None:
    monkeypatch.setattr("pulse_sensors.sensor.REOPEN_EVERY_S", 0.001)
    machine.ports = [listed(NAME, UNO)]

    def rename() -> None:
        machine.gives, machine.ports = failure(errno.ENOENT), [listed("/dev/ttyACM1", UNO)]

    machine.gives = Line(b"\n0.1\n", OSError("pulled"), gone=rename)
    with closing(Sensor(SerialPort(scene()), scene().decoder(), scene())) as sensor:
        blocks = received(sensor, 1)
        until(lambda: sensor.poll() or any("attempts" in fault for fault in sensor.faults()))
        _, reason = sensor.faults()
        assert "is now /dev/ttyACM1" in reason
        machine.gives = failure(errno.EBUSY)
        until(lambda: sensor.poll() or len(logged) == 3)
        machine.ports = [listed(NAME, UNO)]
        machine.gives = Line(b"\n0.2\n0.3\n")
        blocks += received(sensor, 2)
        assert forces(blocks) == [0.1, 0.2, 0.3]
        (gone,) = sensor.faults()
    went, renamed, busy, back = logged
    assert went == f"{NAME} has gone: pulled"
    assert reason.startswith(f"{renamed} (")
    assert "is now /dev/ttyACM1" in renamed
    assert "another program uses it" in busy
    assert back == f"{NAME} is back"
    assert gone.startswith(f"{NAME} was gone 1 time, for ")
