"""Conformance of live sensors: a port that is read by a thread, and a decoder of its data."""

import itertools
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pulse_sensors.samples import DecodedBlock
from pulse_sensors.sensor import Decoder, Port, Sensor, SensorScene
from telepulse.testing.conformance import call_within, check_release, read_table, require

# `Sensor.close` waits for a read, so that no read may take longer.
READ_WITHIN_S = 1.0
OPEN_WITHIN_S = 10.0
# The rate over a second or two may differ from the nominal one by this share.
RATE_ERROR = 0.2
ENDS_S = 3.0
RECOVERS_WITHIN_S = 20.0
# Before each exception at a read.
GOOD_READS = 3
# Blocks that are looked at before a device is closed and opened again.
BLOCKS = 10


def check_sensor(
    section: type[SensorScene],
    keys: Mapping[str, Any],
    folder: Path | None = None,
    seconds: float = 2.0,
) -> None:
    """Check a kind of live sensor, on a device that sends, or an emulation of one.

    Parameters
    ----------
    folder
        Folder from which paths among the keys count; by default the current one.
    seconds
        Time for which the sensor is read.

    Notes
    -----
    A read may not wait for long. Samples must have the shape of the channels, finite values, rising
    times and the table's rate, and the device must be released and open again. After exceptions of
    any kind, at reads and at openings, samples must come again.
    """
    table = read_table(section, keys)
    folder = Path() if folder is None else folder
    with check_release("close"):
        port, decoder = table.device(folder)
        require(isinstance(port.name, str) and port.name, "the port's name is no text")
        _check_port(port, decoder, table)
    with check_release("Sensor.close"):
        sensor = Sensor(*table.device(folder), table)
        try:
            _check_stream(sensor, seconds)
        finally:
            call_within(ENDS_S, "close, while a read waits,", sensor.close)
    with check_release("Sensor.close, after the device has failed,"):
        _check_recovery(table, folder)


class FailingPort:
    """A port that raises what drivers raise: at a read, at the next two openings, and once more."""

    def __init__(self, port: Port) -> None:
        self._port = port
        self.name = port.name
        self._reading: list[Exception | None] = [*[None] * GOOD_READS, OSError("pulled")]
        self._reading += [*[None] * GOOD_READS, MemoryError("read")]
        self._opening: list[Exception | None] = [None, RuntimeError("open"), MemoryError("open")]
        #: True when data has come after all exceptions.
        self.has_recovered = False

    def open(self) -> None:
        """Open the device, or raise."""
        self._port.open()
        self._raise_next(self._opening)

    def read(self) -> Any:
        """Read the device, or raise."""
        data = self._port.read()
        self._raise_next(self._reading)
        self.has_recovered |= bool(data) and not (self._reading or self._opening)
        return data

    def close(self) -> None:
        """Release the device."""
        self._port.close()

    def _raise_next(self, errors: list[Exception | None]) -> None:
        error = errors.pop(0) if errors else None
        if error is not None:
            raise error


def _check_recovery(table: SensorScene, folder: Path) -> None:
    """Check that samples come again after the device has failed in any way."""
    port, decoder = table.device(folder)
    failing = FailingPort(port)
    sensor = Sensor(failing, decoder, table)
    try:
        until_s = time.monotonic() + RECOVERS_WITHIN_S
        has_recovered = has_samples = False
        while not has_samples:
            require(
                time.monotonic() < until_s,
                "no sample came after the device was gone and was opened again:"
                f" {'; '.join(sensor.faults())}",
            )
            time.sleep(0.005)
            # The samples of the poll in which it recovers may be from before.
            had_recovered, has_recovered = has_recovered, failing.has_recovered
            blocks = call_within(READ_WITHIN_S, "poll", sensor.poll)
            has_samples = had_recovered and bool(blocks)
    finally:
        call_within(ENDS_S, "close, after the device has failed,", sensor.close)


def _check_port(port: Port, decoder: Decoder, table: SensorScene) -> None:
    """Check a port that is opened, read, closed, and opened again."""
    for _ in range(2):
        call_within(OPEN_WITHIN_S, "open", port.open)
        blocks: list[DecodedBlock] = []
        until_s = time.monotonic() + READ_WITHIN_S
        while len(blocks) < BLOCKS and time.monotonic() < until_s:
            data = call_within(READ_WITHIN_S, "read", port.read)
            if data:
                blocks += decoder.feed(data)
        for block in blocks:
            _check_block(block, len(table.wire_channels))
        _check_device_times(blocks)
        require(isinstance(decoder.rejected, Counter), "rejected is no Counter")
        call_within(ENDS_S, "close", port.close)
        call_within(ENDS_S, "a second close", port.close)
        decoder.reset()


def _check_block(block: object, channels: int) -> None:
    require(
        isinstance(block, DecodedBlock), f"feed returns {type(block).__name__}, no DecodedBlock"
    )
    assert isinstance(block, DecodedBlock)
    shape = np.shape(block.values)
    require(
        len(shape) == 2 and shape[1] == channels,
        f"feed returns values of shape {shape}, and the table has {channels} channels",
    )
    require(
        np.isfinite(block.values).all(), "feed returns a value that is not finite: count it instead"
    )
    require(block.missing >= 0, "missing is negative")


def _check_device_times(blocks: list[DecodedBlock]) -> None:
    for before, block in itertools.pairwise(blocks):
        then_ns, now_ns = before.device_ns, block.device_ns
        if then_ns is not None and now_ns is not None and not block.restarted:
            require(
                now_ns > then_ns,
                f"the device's time goes back, from {then_ns} to {now_ns} ns, without a restart",
            )


def _check_stream(sensor: Sensor, seconds: float) -> None:
    """Check the samples that a sensor yields as a sensing node reads it."""
    begun_s, count, last_ns = time.monotonic(), 0, 0
    while time.monotonic() < begun_s + seconds:
        time.sleep(0.005)
        for block in call_within(READ_WITHIN_S, "poll", sensor.poll):
            count += len(block.values) + block.missing
            times_ns = list(block.times_ns)
            require(
                all(a < b for a, b in itertools.pairwise([last_ns, *times_ns])),
                "the samples' times go back",
            )
            last_ns = times_ns[-1]
    require(not sensor.losses, f"the device was lost: {'; '.join(sensor.faults())}")
    require(count, f"no sample in {seconds:g} s: {'; '.join(sensor.faults())}")
    rate_hz, nominal_hz = count / (time.monotonic() - begun_s), 1e9 / sensor.period_ns
    require(
        abs(rate_hz / nominal_hz - 1) <= RATE_ERROR,
        f"{rate_hz:.0f} samples a second came, and the table's rate is {nominal_hz:.0f} Hz",
    )
