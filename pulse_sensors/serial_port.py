"""A sensor on a serial port, or on what stands for one: pyserial's URLs."""

import io
import os
import select
from typing import Annotated, Any, Literal

import serial
from pydantic import Field, model_validator
from serial.tools import list_ports

from protocol.errors import SourceError
from pulse_sensors.binary_frames import FrameDecoder
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.text_lines import TextDecoder, TimeUnit

READ_BYTES = 4096
WAIT_S = 0.1


class SerialScene(SensorTable):
    """The `source` table of kind "serial".

    port: a device, or a pyserial URL such as socket://host:port. framing: "text", lines of
    numbers, or "binary" (`binary_frames.py`). device_time: unit of the first number of a
    line, when that is the device's time; column: which number after it is the value, from 0.
    """

    kind: Literal["serial"]
    port: Annotated[str, Field(min_length=1)]
    framing: Literal["text", "binary"]
    baud: Annotated[int, Field(ge=300, le=20_000_000)] = 115_200
    device_time: TimeUnit | None = None
    column: Annotated[int, Field(ge=0, le=100)] = 0

    @model_validator(mode="after")
    def _fits_the_framing(self) -> "SerialScene":
        given = {"device_time", "column"} & self.model_fields_set
        if self.framing == "binary" and given:
            raise ValueError(f'{min(given)} is for framing "text"')
        return self

    def decoder(self) -> FrameDecoder | TextDecoder:
        """Raise SourceError when a library is missing."""
        if self.framing == "binary":
            return FrameDecoder(self.period_ns)
        return TextDecoder(self.period_ns, self.column, self.device_time)


class SerialPort:
    """Bytes from a serial port, as they come."""

    def __init__(self, scene: SerialScene) -> None:
        self.name = scene.port
        self._baud = scene.baud
        self._port: Any = None
        self._waitable = False

    def open(self) -> None:
        """Open the port. Raises SourceError, with a list of ports, when it is not there."""
        try:
            self._port = serial.serial_for_url(
                self.name, self._baud, timeout=WAIT_S, exclusive=True
            )
            self._waitable = _has_descriptor(self._port)
            if self._waitable:
                self._port.timeout = 0
        except Exception as error:  # of the port, the system, the address, the terminal
            number = getattr(error, "errno", None)
            reason = os.strerror(number) if number else str(error)
            known = ", ".join(sorted(port.device for port in list_ports.comports()))
            raise SourceError(
                f"{self.name}: cannot be opened: {reason}; ports here: {known or 'none'}"
            ) from None

    def read(self) -> bytes:
        """Return what has come, nothing after 0.1 s. Raises when the port is gone."""
        data: bytes
        if self._waitable:
            if not select.select([self._port], [], [], WAIT_S)[0]:
                return b""
            data = self._port.read(READ_BYTES)
        else:
            data = self._port.read(1)
            data += self._port.read(self._port.in_waiting)
        return data

    def close(self) -> None:
        """Let go of the port."""
        if self._port is not None:
            self._port.close()
            self._port = None


def _has_descriptor(port: Any) -> bool:
    """Whether `select` can wait for it: a device or a socket on Linux or macOS."""
    try:
        return os.name == "posix" and port.fileno() >= 0
    except (AttributeError, io.UnsupportedOperation):
        return False
