"""A sensor on a serial port, or behind a URL that pyserial opens like one."""

import io
import os
import select
from pathlib import Path
from typing import Annotated, Any, Literal

import serial
from pydantic import Field, model_validator
from serial.tools import list_ports

from protocol.errors import SourceError
from protocol.wire.description import PULSE
from pulse_sensors.binary_frames import FrameDecoder
from pulse_sensors.force_scale import MAX_VALUES
from pulse_sensors.sensor import SensorScene
from pulse_sensors.text_lines import TextDecoder, TimeUnit

Column = Annotated[int, Field(ge=0, le=100)]
READ_BYTES = 4096
WAIT_S = 0.1


class SerialScene(SensorScene):
    """The `source` table of kind "serial".

    port: a device, or a pyserial URL such as socket://host:port. framing: "text", which is lines of
    numbers, or "binary" (`binary_frames.py`). device_time: unit of a line's first number, if that
    is the device's time. column: index of the value among the numbers after it, from 0. columns:
    those of several values; with names and without columns, the first numbers.
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
    def numbers(self) -> tuple[int, ...]:
        """Indices of a line's values among the numbers after its time."""
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
        several = len(self.numbers) > 1
        return tuple(f"column {number}" if several else PULSE for number in self.numbers)

    def device(self, folder: Path) -> "tuple[SerialPort, FrameDecoder | TextDecoder]":
        """See `SensorScene.device`."""
        return SerialPort(self), self.decoder()

    def decoder(self) -> FrameDecoder | TextDecoder:
        """Return the decoder of the framing. Raises SourceError if a library is missing."""
        if self.framing == "binary":
            return FrameDecoder(self.period_ns, len(self.wire_channels))
        return TextDecoder(self.period_ns, self.numbers, self.device_time)


class SerialPort:
    """Port that receives the bytes of a serial line; see `pulse_sensors.sensor.Port`."""

    def __init__(self, scene: SerialScene) -> None:
        self.name = scene.port
        self._baud = scene.baud
        self._port: Any = None
        self._waitable = False

    def open(self) -> None:
        """Open the port. Raises SourceError, with a list of ports, if it cannot be opened."""
        try:
            self._port = serial.serial_for_url(
                self.name, self._baud, timeout=WAIT_S, exclusive=True
            )
            # `select` can wait for a device or a socket on Linux or macOS.
            self._waitable = os.name == "posix" and _descriptor(self._port) >= 0
            if self._waitable:
                self._port.timeout = 0
        except Exception as error:  # pyserial passes on errors of many kinds
            number = getattr(error, "errno", None)
            reason = os.strerror(number) if number else str(error)
            known = ", ".join(sorted(port.device for port in list_ports.comports()))
            raise SourceError(
                f"{self.name}: cannot be opened: {reason}; ports here: {known or 'none'}"
            ) from None

    def read(self) -> bytes:
        """Return the waiting bytes; none after 0.1 s without any. Raises if the port is gone."""
        if self._waitable:
            ready = select.select([self._port], [], [], WAIT_S)[0]
            return bytes(self._port.read(READ_BYTES)) if ready else b""
        first = self._port.read(1)
        return bytes(first + self._port.read(self._port.in_waiting))

    def close(self) -> None:
        """Release the port."""
        if self._port is not None:
            self._port.close()
            self._port = None


def _descriptor(port: Any) -> int:
    try:
        return int(port.fileno())
    except (AttributeError, io.UnsupportedOperation):
        return -1
