"""A sensor on a serial port, or behind a URL that pyserial opens like one."""

import errno
import logging
import os
import socket
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, NoReturn
from urllib.parse import urlsplit

import serial
from pydantic import Field, model_validator
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from protocol.config.quantities import Name
from protocol.errors import SourceError
from protocol.host.descriptors import await_readable
from protocol.wire.description import PULSE
from pulse_sensors.binary_frames import FrameDecoder
from pulse_sensors.force_scale import MAX_VALUES
from pulse_sensors.sensor import SensorScene
from pulse_sensors.text_lines import TextDecoder, TimeUnit

logger = logging.getLogger(__name__)

Column = Annotated[int, Field(ge=0, le=100)] | Name
READ_BYTES = 4096
WAIT_S = 0.1
SOCKET = "socket://"
CONNECT_WITHIN_S = 5.0


class SerialScene(SensorScene):
    """The `source` table of kind "serial".

    port: a device, or a pyserial URL such as socket://host:port. framing: "text", which is lines of
    numbers, or "binary" (`binary_frames.py`). device_time: unit of a line's first number, if that
    is the device's time. column: index of the value among the numbers after it, from 0, or its
    label. columns: those of several values; with names and without columns, the first numbers.
    """

    kind: Literal["serial"]
    port: Annotated[str, Field(min_length=1)]
    framing: Literal["text", "binary"]
    baud: Annotated[int, Field(ge=300, le=20_000_000)] = 115_200
    device_time: TimeUnit | None = None
    column: Column = 0
    columns: Annotated[tuple[Column, ...], Field(min_length=1, max_length=MAX_VALUES)] | None = None

    @model_validator(mode="after")
    def _fits_the_framing(self) -> "SerialScene":
        given = {"device_time", "column", "columns"} & self.model_fields_set
        if self.framing == "binary" and given:
            raise ValueError(f'{min(given)} is for framing "text"')
        if {"column", "columns"} <= given:
            raise ValueError("column is one, columns are several; give one of the two keys")
        return self

    @property
    def numbers(self) -> tuple[int | str, ...]:
        """Labels of a line's values, or their indices among the numbers after its time."""
        if self.columns is not None:
            return self.columns
        if self.names is None or "column" in self.model_fields_set:
            return (self.column,)
        return tuple(range(len(self.names)))

    @property
    def value_names(self) -> tuple[str, ...]:
        """Names of a sample's values, in order, where the scene gives none."""
        if self.framing == "binary":
            return self.names or (PULSE,)
        if len(self.numbers) == 1:
            return (PULSE,)
        return tuple(n if isinstance(n, str) else f"column {n}" for n in self.numbers)

    def device(self, folder: Path) -> "tuple[SerialPort, FrameDecoder | TextDecoder]":
        """See `SensorScene.device`."""
        return SerialPort(self), self.decoder()

    def decoder(self) -> FrameDecoder | TextDecoder:
        """Return the decoder of the framing. Raises SourceError if a library is missing."""
        if self.framing == "binary":
            return FrameDecoder(self.period_ns, len(self.wire_channels))
        units = [self.announce_unit if c.announces else self.unit for c in self.wire_channels]
        return TextDecoder(self.period_ns, self.numbers, self.device_time, units)


class UsbDevice(NamedTuple):
    """The USB device behind a serial port."""

    vendor: int
    product: int
    serial_number: str | None

    def __str__(self) -> str:
        number = self.serial_number
        numbered = f"serial number {number}" if number else "without a serial number"
        return f"USB {self.vendor:04X}:{self.product:04X}, {numbered}"


class SerialPort:
    """Port that receives the bytes of a serial line; see `pulse_sensors.sensor.Port`.

    After its first opening it takes the same device alone, where that is known.
    """

    def __init__(self, scene: SerialScene) -> None:
        self.name = scene.port
        self._baud = scene.baud
        self._port: Any = None
        # Of a device or a socket on Linux or macOS; -1 where only pyserial can read.
        self._descriptor = -1
        # The sensor's device, None while it is not known, and the ports beside it.
        self._device: UsbDevice | None = None
        self._beside: set[str] = set()

    def open(self) -> None:
        """Open the port. Raises SourceError with the reason, and the ports that are there."""
        try:
            if self.name.startswith(SOCKET) and os.name == "posix":
                self._port = _connect(self.name)
            else:
                self._port = serial.serial_for_url(
                    self.name, self._baud, timeout=WAIT_S, exclusive=True
                )
            self._descriptor = _descriptor(self._port)
        except Exception as error:  # pyserial passes on errors of many kinds
            self._refuse(f"cannot be opened: {self._reason(error)}")
        ports = _ports()
        device = next((_usb_device(port) for port in ports if self._is_own(port)), None)
        if device is not None and self._device not in (None, device):
            self._refuse(
                f"another device is there, {device}; the sensor, {self._device}, is"
                f" {self._whereabouts(ports) or 'gone'}: connect it as it was, or start again"
            )
        self._device = device or self._device
        self._beside = {port.device for port in ports if not self._is_own(port)}

    def read(self) -> bytes:
        """Return the waiting bytes; none after 0.1 s without any. Raises if the port is gone."""
        if self._descriptor < 0:
            first = self._port.read(1)
            return bytes(first + self._port.read(self._port.in_waiting))
        if not await_readable(self._descriptor, WAIT_S):
            return b""
        if data := os.read(self._descriptor, READ_BYTES):
            return data
        raise OSError("its other end is closed")

    def close(self) -> None:
        """Release the port."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def _refuse(self, reason: str) -> NoReturn:
        self.close()
        known = ", ".join(sorted(port.device for port in _ports()))
        raise SourceError(f"{self.name}: {reason}; ports here: {known or 'none'}") from None

    def _reason(self, error: Exception) -> str:
        """Return why the port cannot be opened, and advice where there is some."""
        number = getattr(error, "errno", None) or 0
        # A host's look-up has negative numbers of its own.
        reason = os.strerror(number) if number > 0 else str(error) or type(error).__name__
        if number in (errno.EBUSY, errno.EAGAIN):
            return f"{reason}; another program uses it: end that one (fuser names it)"
        if number in (errno.EACCES, errno.EPERM):
            return (
                f"{reason}; this user may not open it: sudo usermod -aG dialout $USER, then log in"
                " again"
            )
        if place := self._whereabouts(_ports()):
            return (
                f"{reason}; the same device ({self._device}) is {place}: give `port` the name of"
                " it that stays, in /dev/serial/by-id"
            )
        return reason

    def _is_own(self, port: ListPortInfo) -> bool:
        return port.device in (self.name, os.path.realpath(self.name))

    def _whereabouts(self, ports: Iterable[ListPortInfo]) -> str:
        """Return "now" and the other ports at which the sensor's device is; empty without any."""
        device = self._device
        names = [
            port.device
            for port in ports
            if device is not None and _usb_device(port) == device and not self._is_own(port)
            # Without serial numbers, a port that was there before is another device's.
            if device.serial_number or port.device not in self._beside
        ]
        return f"now {' or '.join(sorted(names))}" if names else ""


def _ports() -> list[ListPortInfo]:
    """Return the ports that are there; none where the system cannot list them."""
    try:
        return list(list_ports.comports())
    except Exception as error:  # of the system's own library; a sensor does without the list
        logger.debug(f"serial ports cannot be listed: {error}")
        return []


def _usb_device(port: ListPortInfo) -> UsbDevice | None:
    """Return the device of a port; None where the system does not name it."""
    if port.vid is None or port.pid is None:
        return None
    return UsbDevice(port.vid, port.pid, port.serial_number)


def _connect(name: str) -> socket.socket:
    """Connect to the host and port of a socket:// URL.

    pyserial waits for its sockets with `select`, which takes no descriptor above 1 023.
    """
    place = urlsplit(name)
    if place.hostname is None or place.port is None:
        raise ValueError(f"write {SOCKET}HOST:PORT")
    return socket.create_connection((place.hostname, place.port), CONNECT_WITHIN_S)


def _descriptor(port: Any) -> int:
    """Return the descriptor of a port that can be read without pyserial, else -1.

    pyserial reads and writes devices with `select` as well.
    """
    if os.name != "posix":
        return -1
    try:
        number = int(port.fileno())
    except (AttributeError, OSError):  # io.UnsupportedOperation is an OSError
        return -1
    os.set_blocking(number, False)
    return number
