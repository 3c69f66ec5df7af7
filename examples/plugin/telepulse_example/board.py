"""A live sensor: a board that sends a sine of force. This one is emulated by the host's clock."""

import math
import time
from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from protocol.config.quantities import Hertz
from telepulse.plugins import DecodedBlock, SensorScene, SourceError, decoded_block

PACKET_S = 0.005


class BoardScene(SensorScene):
    """The `source` or `feedback` table of kind "sine_board"."""

    kind: Literal["sine_board"]
    frequency_hz: Annotated[Hertz, Field(gt=0, le=50)] = 1.25

    def device(self, folder: Path) -> "tuple[BoardPort, BoardDecoder]":
        """See `SensorScene.device`."""
        return BoardPort(self.rate_hz), BoardDecoder(self)


class BoardPort:
    """Port of the board; its data is the number of a packet's first sample, and their count."""

    name = "the sine board"

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._opened_s: float | None = None
        self._sent = 0

    def open(self) -> None:
        """Begin to send."""
        self._opened_s, self._sent = time.monotonic(), 0

    def read(self) -> tuple[int, int] | None:
        """Wait for a packet. Raises SourceError when the port is not open."""
        if self._opened_s is None:
            raise SourceError(f"{self.name} is not open")
        time.sleep(PACKET_S)
        first = self._sent
        self._sent = int((time.monotonic() - self._opened_s) * self._rate_hz)
        return (first, self._sent - first) if self._sent > first else None

    def close(self) -> None:
        """Cease to send."""
        self._opened_s = None


class BoardDecoder:
    """Decoder of the board's packets; its clock counts the samples."""

    def __init__(self, scene: BoardScene) -> None:
        self._scene = scene
        self.rejected: Counter[str] = Counter()
        self.reset()

    def reset(self) -> None:
        """Expect a clock that begins anew."""
        self._restarted = True

    def feed(self, packet: tuple[int, int]) -> list[DecodedBlock]:
        """Return the packet as one block."""
        scene, (first, count) = self._scene, packet
        step = 2 * math.pi * scene.frequency_hz * scene.period_ns * 1e-9
        values = [0.3 + 0.1 * math.sin(step * (first + number)) for number in range(count)]
        device_ns = (first + count) * scene.period_ns
        block = decoded_block(values, device_ns, restarted=self._restarted)
        self._restarted = False
        return [block]
