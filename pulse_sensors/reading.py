"""Samples of a sensor on their way from a decoder to the host's clock.

A decoder makes a `Packet` of a device's bytes. `Timeline` places its samples one after the other,
and `Readings` converts it to a `Reading`: forces in newtons with times on the host's clock.

A delay-locked loop (F. Adriaensen, "Using a DLL to filter time", 2005): the next sample's time
is predicted, and each measured time pulls prediction and period a little its way. So what a
stream says of its times is even and never steps back, whatever jitter the measuring has.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

from protocol.clock.one_way import DeviceClock
from protocol.config.quantities import count_text
from pulse_sensors.force_scale import SensorTable

# Beyond it, NaN included, no unit of a sensor leaves a force that a frame can carry.
LARGEST = 1e30


@dataclass(frozen=True, slots=True)
class Packet:
    """Consecutive samples in the sensor's own unit, at least one.

    device_ns: the device's clock at the last of them; None from a device that sends no time.
    missing: samples that were lost right before them, as far as the bytes tell.
    anew: the device's clock has nothing to do with what it said before.
    """

    values: tuple[float, ...]
    device_ns: int | None = None
    missing: int = 0
    anew: bool = False


# Of the loop, once it has settled; until then as much as the time seen so far allows.
BANDWIDTH_HZ = 0.2
SETTLING = 0.5
LARGEST_OMEGA = 0.3
# Samples stretched by more than this would be felt, and displays take half or double at most.
LARGEST_STRETCH = 0.2
LARGEST_RATE_ERROR = 0.5
# Beyond this it is no jitter: samples are missing, or the time is wrong.
JUMP_NS = 250_000_000


class Span(NamedTuple):
    """Place of consecutive samples in time.

    It has the time of the first, the time at which the one after the last is due, and the number of
    samples missing right before them.
    """

    first_ns: int
    end_ns: int
    missing: int


class Timeline:
    """Gives every sample its place. Pure: measured times on the host's clock come in."""

    def __init__(self, period_ns: int) -> None:
        """period_ns: the nominal one."""
        self._nominal_ns = period_ns
        self._period_ns = float(period_ns)
        # Times as differences to the first, which are exact as floats.
        self._origin_ns: int | None = None
        self._next_ns = 0.0
        self._measured_ns = 0.0

    def place(self, count: int, missing: int, last_ns: int) -> Span | None:
        """Return the place of `count` samples, the last of which was measured at `last_ns`.

        missing: how many are known to be lost before them; a jump of the time shows more. None
        for samples whose time is long over: they cannot be placed any more.
        """
        if self._origin_ns is None:
            self._origin_ns = last_ns - (count - 1) * self._nominal_ns
        error_ns = self._error_ns(count, missing, last_ns)
        if error_ns > JUMP_NS:
            missing += round(error_ns / self._period_ns)
            error_ns = self._error_ns(count, missing, last_ns)
        elif error_ns < -JUMP_NS:
            return None
        first_ns = self._next_ns + missing * self._period_ns
        self._next_ns = first_ns + self._follow(first_ns, count, error_ns)
        origin_ns = self._origin_ns
        return Span(origin_ns + round(first_ns), origin_ns + round(self._next_ns), missing)

    @property
    def rate_hz(self) -> float:
        """Samples a second, as measured."""
        return 1e9 / self._period_ns

    def _error_ns(self, count: int, missing: int, last_ns: int) -> float:
        assert self._origin_ns is not None
        predicted_ns = self._next_ns + (missing + count - 1) * self._period_ns
        return last_ns - self._origin_ns - predicted_ns

    def _follow(self, first_ns: float, count: int, error_ns: float) -> float:
        """Pull the period; how long the samples take, so that the next one's time is pulled too."""
        period_ns = self._period_ns
        end_ns = first_ns + count * period_ns
        # After a long packet that was pulled forward, a short one may end before it was to end.
        passed_ns = max(end_ns - self._measured_ns, period_ns)
        self._measured_ns = end_ns
        bandwidth_hz = max(BANDWIDTH_HZ, SETTLING * 1e9 / end_ns)
        omega = min(2 * math.pi * bandwidth_hz * passed_ns * 1e-9, LARGEST_OMEGA)
        pulled_ns = period_ns * (1 + omega * omega * error_ns / passed_ns)
        self._period_ns = _within(pulled_ns, LARGEST_RATE_ERROR, self._nominal_ns)
        step_ns = period_ns + math.sqrt(2) * omega * error_ns / count
        return count * _within(step_ns, LARGEST_STRETCH, period_ns)


def _within(value: float, share: float, of: float) -> float:
    """Return the value, or the nearest that differs from `of` by no more than a share of it."""
    return min(max(value, of * (1 - share)), of * (1 + share))


# Measured and nominal rate differ by more than any resonator's error.
RATE_TOLERANCE = 0.02
SETTLED_S = 2.0


class Reading(NamedTuple):
    """Consecutive samples on the host's clock.

    It has the time of the first, the time at which the one after the last is due, forces in N, and
    the number of samples lost right before them.
    """

    first_ns: int
    end_ns: int
    force_n: tuple[float, ...]
    missing: int

    @property
    def times_ns(self) -> list[int]:
        """Times at which the samples were taken."""
        count, span_ns = len(self.force_n), self.end_ns - self.first_ns
        return [self.first_ns + number * span_ns // count for number in range(count)]


class Readings:
    """The conversion of one sensor's packets to readings. Pure: arrivals' times come in.

    samples: placed so far; missing: lost before them. restarts: how often the device's clock
    began anew. behind: packets that were refused because the stream was past their time.
    """

    def __init__(self, table: SensorTable) -> None:
        self._nominal_hz = table.rate_hz
        self._scale = table.force_scale()
        self._timeline = Timeline(table.period_ns)
        self._clock = DeviceClock()
        self.samples = self.missing = self.restarts = self.behind = 0
        self._arrived_ns = 0
        # Sample and time from which on the measured rate has not been the nominal one.
        self._off_since: tuple[int, int] | None = None

    def of(self, packet: Packet, arrival_ns: int) -> Reading | None:
        """Return the packet's samples in their place; None when there is no place for them."""
        last_ns = arrival_ns
        if packet.device_ns is not None:
            if packet.anew:
                self.restarts += self.samples > 0
                self._clock = DeviceClock()
            self._clock.observe(packet.device_ns, arrival_ns)
            # Nothing arrives before it was taken, whatever the device says.
            last_ns = min(self._clock.host_ns(packet.device_ns), arrival_ns)
        span = self._timeline.place(len(packet.values), packet.missing, last_ns)
        if span is None:
            self.behind += 1
            return None
        self.samples += len(packet.values)
        self.missing += span.missing
        self._watch_rate(arrival_ns, whole=not span.missing)
        force_n = self._scale.newtons(packet.values)
        return Reading(span.first_ns, span.end_ns, force_n, span.missing)

    @property
    def skew_ppm(self) -> float:
        """Rate of the device's clock beyond the host's, in ppm; 0 when it sends no time."""
        return self._clock.skew_ppm

    def faults(self, name: str) -> list[str]:
        """Return what went wrong with the sensor of that name, one line each."""
        if not self.samples:
            return [f"no sample came from {name}"]
        faults = []
        if self.missing:
            faults.append(f"{count_text(self.missing, 'sample')} missing from {name}")
        if self.restarts:
            faults.append(f"{name} began its clock anew {count_text(self.restarts, 'time')}")
        if self.samples > SETTLED_S * self._nominal_hz and self._rate_is_off:
            faults.append(self._rate_fault(name, self._timeline.rate_hz))
        return faults

    def lasting_rate_fault(self, name: str) -> str | None:
        """Return that the sensor's rate is not the scene's, once it has been so for 2 s."""
        if self._off_since is None:
            return None
        first, since_ns = self._off_since
        count, span_ns = self.samples - first, self._arrived_ns - since_ns
        if count <= SETTLED_S * self._nominal_hz or span_ns <= 0:
            return None
        # Counted: far off the nominal one, the timeline takes longer than this to find the rate.
        return self._rate_fault(name, count * 1e9 / span_ns)

    def _watch_rate(self, arrival_ns: int, whole: bool) -> None:
        """Remember since when the measured rate has not been the nominal one, no sample missing."""
        self._arrived_ns = arrival_ns
        if not self._rate_is_off:
            self._off_since = None
        elif self._off_since is None or not whole:
            self._off_since = (self.samples, arrival_ns)

    @property
    def _rate_is_off(self) -> bool:
        return abs(self._timeline.rate_hz / self._nominal_hz - 1) > RATE_TOLERANCE

    def _rate_fault(self, name: str, rate_hz: float) -> str:
        scene_hz = f"{self._nominal_hz:g} Hz"
        return f"{name} sends {rate_hz:.0f} Hz, the scene says {scene_hz}: check its rate"
