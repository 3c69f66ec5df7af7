"""Samples of a live sensor: from decoded blocks to forces at times on the host's clock.

A decoder makes `DecodedBlock`s from a device's bytes, in the sensor's unit and at times on the
device's clock, with the help of `DeviceTime` and `SampleCounter`. `Timestamper` converts each to a
`SampleBlock`, in the channels' units and at even times on the host's clock, which `Timeline`
computes.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.clock.one_way import DeviceClock
from protocol.config.quantities import count_text
from protocol.wire.messages import LARGEST_N
from pulse_sensors.force_scale import MILLIVOLTS, SensorTable
from pulse_sensors.sample_plausibility import RateCheck


class DecodedBlock(NamedTuple):
    """Consecutive samples as a device sent them.

    Attributes
    ----------
    values : ndarray, shape (samples, channels)
        At least one sample, in the sensor's unit.
    device_ns : int, optional
        Time of the last sample on the device's clock; None if the device sends no time.
    missing : int
        Number of samples lost right before these, at least 0.
    restarted : bool
        True if the device's clock does not continue that of the previous block.
    """

    values: NDArray[np.float64]
    device_ns: int | None = None
    missing: int = 0
    restarted: bool = False


# Bytes or characters of a device's data in a warning.
QUOTED = 60


def quoted(data: object) -> str:
    """Return the begin of a device's data for people, as they came, escaped."""
    text = repr(data[:QUOTED])[1:] if isinstance(data, bytes) else repr(str(data)[:QUOTED])
    length = len(data) if isinstance(data, bytes) else len(str(data))
    return text if length <= QUOTED else f"{text[:-1]}…{text[-1]}"


Values = Sequence[float] | Sequence[Sequence[float]]
"""Samples of one channel, or of several: then the values of each sample."""


def decoded_block(
    values: Values, device_ns: int | None = None, missing: int = 0, restarted: bool = False
) -> DecodedBlock:
    """Return a decoder's values as a block."""
    table = np.array(values, np.float64).reshape(len(values), -1)
    return DecodedBlock(table, device_ns, missing, restarted)


def join_samples(
    samples: Iterable[tuple[Sequence[float], int | None, int, bool]],
) -> list[DecodedBlock]:
    """Return samples, each its values, `device_ns`, `missing` and `restarted`, as blocks.

    Each loss and each restart begins a block. A block has the time of its last sample, which has
    waited least.
    """
    blocks: list[tuple[list[Sequence[float]], int | None, int, bool]] = []
    for sample, device_ns, missing, restarted in samples:
        if blocks and not missing and not restarted:
            rows, _, missing, restarted = blocks.pop()
        else:
            rows = []
        rows.append(sample)
        blocks.append((rows, device_ns, missing, restarted))
    return [decoded_block(*block) for block in blocks]


_TURN_US = 1 << 32
# After a longer pause, the device's clock has stepped, or the device has restarted.
LONGEST_PAUSE_NS = 10_000_000_000


class DeviceTime:
    """Continuous time from the low 32 bits of a device's count of µs. Pure.

    An Arduino's millis() times 1000 works too: it wraps after 1000 wraps of 2^32 µs.

    last_us, last_ns: the last count, None before any, and its continuous time.
    """

    def __init__(self) -> None:
        self.last_us: int | None = None
        self.last_ns = 0

    def since_last_ns(self, now_us: int) -> int | None:
        """Return the time since the last count; None after a restart or a step."""
        if self.last_us is None:
            return None
        passed_ns = (now_us - self.last_us) % _TURN_US * 1_000
        return passed_ns if 0 < passed_ns <= LONGEST_PAUSE_NS else None

    def take(self, now_us: int) -> int:
        """Return a count's time in ns, which continues the last one.

        After a restart or a step, it is the count itself.
        """
        passed_ns = self.since_last_ns(now_us)
        restart_ns = now_us % _TURN_US * 1_000
        self.last_ns = restart_ns if passed_ns is None else self.last_ns + passed_ns
        self.last_us = now_us
        return self.last_ns


# The time passed may differ from the counted time by half of the latter plus this.
COUNTER_TOLERANCE_NS = 50_000_000


class SampleCounter:
    """Losses from a device's count of its samples, which wraps to 0 at `modulus`. Pure.

    A count and a time that contradict each other are counted in `rejected` as "counter".
    """

    def __init__(self, modulus: int, period_ns: int, rejected: Counter[str]) -> None:
        self._modulus = modulus
        self._period_ns = period_ns
        self._rejected = rejected
        self._next = 0

    def missing(self, first: int, count: int, passed_ns: int | None) -> int:
        """Return the number of samples lost before `count` new ones, numbered from `first` on.

        passed_ns: time from the last sample before to the last of these; None if unknown.
        """
        jump = (first - self._next) % self._modulus
        self._next = first + count
        if passed_ns is None or not jump:
            return 0
        counted_ns = (jump + count) * self._period_ns
        if abs(passed_ns - counted_ns) <= COUNTER_TOLERANCE_NS + counted_ns // 2:
            return jump
        self._rejected["counter"] += 1
        return 0


class SampleBlock(NamedTuple):
    """Consecutive samples on the host's clock, as live sensors and all feeds yield them.

    Attributes
    ----------
    values : ndarray, shape (samples, channels)
        At least one sample, in the channels' units.
    missing : int
        Number of samples lost right before these, at least 0.
    first_ns, end_ns : int
        Time of the first sample, and time at which the sample after the last is due.
    """

    values: NDArray[np.float64]
    missing: int
    first_ns: int
    end_ns: int

    @property
    def period_ns(self) -> int:
        """Mean time between the samples."""
        return round((self.end_ns - self.first_ns) / len(self.values))

    @property
    def times_ns(self) -> list[int]:
        """Times at which the samples were taken."""
        count, span_ns = len(self.values), self.end_ns - self.first_ns
        return [self.first_ns + number * span_ns // count for number in range(count)]

    @property
    def force_n(self) -> list[float]:
        """Forces of the first channel in N."""
        forces_n: list[float] = self.values[:, 0].tolist()
        return forces_n


# Bandwidth of the settled loop. Until then it is SETTLING over the time since the first sample.
BANDWIDTH_HZ = 0.2
SETTLING = 0.5
LARGEST_OMEGA = 0.3
# Greatest change of the time between samples. A larger one would be felt.
LARGEST_STRETCH = 0.2
LARGEST_RATE_ERROR = 0.5
# Shortest time between samples, in nominal periods: displays refuse less than 0.5 and more than 2.
SHORTEST_STEP = 0.55
# Greatest jitter; a larger error means that samples are missing, or the time is wrong.
JUMP_NS = 250_000_000


class Timeline:
    """Even times for samples whose measured times jitter. Pure.

    A delay-locked loop predicts the time of the next sample. Each measured time corrects prediction
    and period by a part of the error. The resulting times never go back.

    References
    ----------
    F. Adriaensen, "Using a DLL to filter time", 2005.
    """

    def __init__(self, period_ns: int) -> None:
        self._nominal_ns = period_ns
        self._period_ns = float(period_ns)
        # Times are differences to the first, which are exact as floats.
        self._origin_ns: int | None = None
        self._next_ns = self._measured_ns = 0.0

    @property
    def rate_hz(self) -> float:
        """Measured samples per second."""
        return 1e9 / self._period_ns

    def place(self, count: int, missing: int, last_ns: int) -> tuple[int, int, int] | None:
        """Return the times of `count` samples, the last of which was measured at `last_ns`.

        missing: samples known to be lost before them; a jump of the time may show more. Returns
        first_ns, end_ns and missing as in `SampleBlock`; None if they are earlier than the last.
        """
        if self._origin_ns is None:
            # Samples may be lost before the first one.
            self._origin_ns = last_ns - (missing + count - 1) * self._nominal_ns
        origin_ns, period_ns = self._origin_ns, self._period_ns
        passed_ns = last_ns - origin_ns
        error_ns = passed_ns - (self._next_ns + (missing + count - 1) * period_ns)
        if error_ns > JUMP_NS:
            missing += round(error_ns / period_ns)
            error_ns = passed_ns - (self._next_ns + (missing + count - 1) * period_ns)
        elif error_ns < -JUMP_NS:
            return None
        first_ns = self._next_ns + missing * period_ns
        self._next_ns = first_ns + count * self._correct(first_ns, count, error_ns)
        return origin_ns + round(first_ns), origin_ns + round(self._next_ns), missing

    def _correct(self, first_ns: float, count: int, error_ns: float) -> float:
        """Correct the period; return the time between this block's samples."""
        period_ns = self._period_ns
        end_ns = first_ns + count * period_ns
        # A short block may end before a long one whose times were corrected forward.
        passed_ns = max(end_ns - self._measured_ns, period_ns)
        self._measured_ns = end_ns
        bandwidth_hz = max(BANDWIDTH_HZ, SETTLING * 1e9 / end_ns)
        omega = min(2 * math.pi * bandwidth_hz * passed_ns * 1e-9, LARGEST_OMEGA)
        corrected_ns = period_ns * (1 + omega * omega * error_ns / passed_ns)
        self._period_ns = _bounded(corrected_ns, LARGEST_RATE_ERROR, self._nominal_ns)
        step_ns = period_ns + math.sqrt(2) * omega * error_ns / count
        return max(_bounded(step_ns, LARGEST_STRETCH, period_ns), SHORTEST_STEP * self._nominal_ns)


def _bounded(value: float, share: float, of: float) -> float:
    """Return the value, bounded to a share of `of` above and below `of`."""
    return min(max(value, of * (1 - share)), of * (1 + share))


class Timestamper:
    """Conversion of one sensor's decoded blocks to its channels' units on the host's clock. Pure.

    samples, missing: numbers of samples so far, and of those lost before them. restarts: of the
    device's clock, followed by `clock`. behind: samples refused as earlier than the last.
    too_large: samples refused, since one of them is too large for a frame. rate: the check of the
    rate.
    """

    def __init__(self, table: SensorTable) -> None:
        self._table = table
        announcing = [number for number, c in enumerate(table.wire_channels) if c.announces]
        self._announcing, self._millivolts = announcing, MILLIVOLTS[table.announce_unit]
        self._timeline = Timeline(table.period_ns)
        self.clock = DeviceClock()
        self.rate = RateCheck(table.rate_hz)
        self.samples = self.missing = self.restarts = self.behind = self.too_large = 0
        # Samples lost or too large since the last block that was placed, and whether the device's
        # clock restarted with them.
        self._lost, self._restarted = 0, False

    def timestamp(self, block: DecodedBlock, arrival_ns: int) -> SampleBlock | None:
        """Return a decoder's block, scaled, with its times; None if it is refused.

        It is refused if it is earlier than the last. If a value is too large for a frame, which the
        displays would refuse with all its samples, the block's samples are lost.
        """
        count, values = len(block.values), self._table.newtons(block.values)
        if self._announcing:
            values[:, self._announcing] = self._millivolts * block.values[:, self._announcing]
        # The square of the norm is one call for all; it may be too large although no value is.
        flat = values.ravel()
        if not flat.dot(flat) <= LARGEST_N**2 and not np.abs(flat).max() <= LARGEST_N:
            self.too_large += count
            self._lost += block.missing + count
            self._restarted |= block.restarted
            return None
        lost, restarted = self._lost + block.missing, self._restarted or block.restarted
        self._lost, self._restarted = lost, False
        last_ns = arrival_ns
        if block.device_ns is not None:
            if restarted:
                self.restarts += self.samples > 0
                self.clock = DeviceClock()
            self.clock.observe(block.device_ns, arrival_ns)
            # No sample arrives before it is taken, so the arrival bounds the device's time.
            last_ns = min(self.clock.host_ns(block.device_ns), arrival_ns)
        times_ns = self._timeline.place(count, lost, last_ns)
        self.rate.add(block.missing + count, arrival_ns, self._timeline.rate_hz)
        if times_ns is None:
            self.behind += count
            return None
        first_ns, end_ns, missing = times_ns
        self._lost = 0
        self.samples += count
        self.missing += missing
        return SampleBlock(values, missing, first_ns, end_ns)

    def faults(self, name: str) -> list[str]:
        """Return the faults of a sensor, one line each, which names the sensor."""
        if not self.samples:
            return [f"no sample came from {name}"]
        faults = []
        if self.missing:
            faults.append(f"{count_text(self.missing, 'sample')} missing from {name}")
        if self.restarts:
            faults.append(f"{name} restarted its clock {count_text(self.restarts, 'time')}")
        rate_fault = self.rate.fault(name)
        return faults if rate_fault is None else [*faults, rate_fault]
