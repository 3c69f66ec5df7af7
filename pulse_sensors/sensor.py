"""A live sensor's shell: a thread that listens to the device, and who fetches what it heard.

The thread waits for bytes, stamps their arrival, and opens the device again when it has gone.
All else happens in the caller's thread, in `poll`.
"""

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple, Protocol

from protocol.config.quantities import count_text
from protocol.errors import SourceError
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.reading import Packet, Reading, Readings

logger = logging.getLogger(__name__)

MAX_WAITING = 10_000
REOPEN_EVERY_S = 0.2


class Port(Protocol):
    """A device that can be listened to."""

    @property
    def name(self) -> str:
        """Name for people."""

    def open(self) -> None:
        """Open the device. Raises SourceError when it is not there or cannot be used."""

    def read(self) -> Any:
        """Return what arrived, for the decoder; after a while without anything, something false.

        Raises whatever its driver does when the device has gone.
        """

    def close(self) -> None:
        """Let go of it; a closed one may be closed again."""


class Decoder(Protocol):
    """The conversion of a port's data to packets; counts what it cannot use. Pure."""

    @property
    def rejected(self) -> Counter[str]:
        """Count of refusals by cause."""

    def feed(self, data: Any) -> list[Packet]:
        """Return the packets that end in these bytes."""

    def reset(self) -> None:
        """Begin anew, as after a cable was pulled."""


class _Received(NamedTuple):
    """Message of the thread: data that arrived, or the reason why the device is gone.

    With neither, the device is back.
    """

    at_ns: int
    data: Any = None
    gone: Exception | None = None


class Sensor:
    """A live sensor, read from its construction to `close`."""

    def __init__(
        self,
        port: Port,
        decoder: Decoder,
        table: SensorTable,
        clock: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Open the device. Raises SourceError when it is not there. `clock` returns ns."""
        self.period_ns = table.period_ns
        self._port = port
        self._decoder = decoder
        self._readings = Readings(table)
        self._clock = clock
        self._heard: deque[_Received] = deque()
        self._backlog = 0
        self._losses = 0
        self._rate_reported = False
        self._gone_since_ns: int | None = None
        self._gone_for_ns = 0
        self._closing = threading.Event()
        port.open()
        self._thread = threading.Thread(target=self._listen, name=port.name, daemon=True)
        self._thread.start()

    def poll(self) -> list[Reading]:
        """Return the readings that have come since the last call, in order. Never waits."""
        readings = []
        while self._heard:
            heard = self._heard.popleft()
            if heard.data is None:
                self._go_or_return(heard)
                continue
            for packet in self._decoder.feed(heard.data):
                reading = self._readings.of(packet, heard.at_ns)
                if reading is not None:
                    readings.append(reading)
        if readings and not self._rate_reported:
            fault = self._readings.lasting_rate_fault(self._port.name)
            self._rate_reported = fault is not None
            if fault is not None:
                logger.warning(fault)
        return readings

    @property
    def rejected(self) -> Counter[str]:
        """Count of what could not be used, by cause."""
        rejected = Counter(self._decoder.rejected)
        rejected["behind"] += self._readings.behind
        rejected["backlog"] += self._backlog
        return +rejected

    @property
    def skew_ppm(self) -> float:
        """Rate of the device's clock beyond the host's, in ppm; 0 when it sends no time."""
        return self._readings.skew_ppm

    def faults(self) -> list[str]:
        """Return what went wrong so far, one line each."""
        faults = self._readings.faults(self._port.name)
        if self._losses:
            gone_ns = self._gone_for_ns
            if self._gone_since_ns is not None:
                gone_ns += self._clock() - self._gone_since_ns
            times = f"{count_text(self._losses, 'time')}, for {gone_ns * 1e-9:.1f} s in all"
            faults.insert(0, f"{self._port.name} was gone {times}")
        return faults

    def close(self) -> None:
        """Stop listening."""
        self._closing.set()
        self._thread.join()
        self._port.close()

    def _go_or_return(self, heard: _Received) -> None:
        if heard.gone is not None:
            self._losses += 1
            self._gone_since_ns = heard.at_ns
            logger.warning(f"{self._port.name} has gone: {heard.gone}")
        elif self._gone_since_ns is not None:
            self._gone_for_ns += heard.at_ns - self._gone_since_ns
            self._gone_since_ns = None
            self._decoder.reset()
            logger.info(f"{self._port.name} is back")

    def _listen(self) -> None:
        """Read the device until closed; runs in the thread."""
        while not self._closing.is_set():
            try:
                data = self._port.read()
            except Exception as error:  # each driver raises what it does
                self._heard.append(_Received(self._clock(), gone=error))
                # What has gone may fail once more when it is let go; that it has gone is told.
                with suppress(Exception):
                    self._port.close()
                self._reopen()
                continue
            if not data:
                continue
            if len(self._heard) < MAX_WAITING:
                self._heard.append(_Received(self._clock(), data))
            else:
                self._backlog += 1

    def _reopen(self) -> None:
        while not self._closing.wait(REOPEN_EVERY_S):
            try:
                self._port.open()
            except SourceError:
                continue
            self._heard.append(_Received(self._clock()))
            return
