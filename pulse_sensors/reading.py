"""A sensor's packets as readings: samples in newtons, each with its time on the host's clock."""

from typing import NamedTuple

from protocol.clock.device_clock import DeviceClock
from protocol.config.quantities import count_text
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.packet import Packet
from pulse_sensors.timeline import Timeline

# Measured and nominal rate differ by more than any resonator's error.
RATE_TOLERANCE = 0.02
SETTLED_S = 2.0


class Reading(NamedTuple):
    """Consecutive samples on the host's clock: the first's time, when the one after the last
    would come, forces in N, and how many samples were lost right before them."""

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
        """The packet's samples in their place; None when there is no place for them."""
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
