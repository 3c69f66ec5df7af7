"""Plausibility of what a sensor sends: its numbers, stated unit and rate, and its samples.

- A decoder's number: `is_usable`.
- Unit and rate that a device states: `unit_contradiction`, `rate_contradiction`.
- The measured rate of a live sensor: `RateCheck`.
- The samples of a running source, channel by channel: `SampleCheck`.

A recording, which is completely known when it is opened, is checked by
`sensing_node/files/recording_plausibility.py`, the film under the finger by
`display_node/plant/film_plausibility.py`.
"""

import logging
import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.config.quantities import count_text
from protocol.wire.description import Channel
from pulse_sensors.force_scale import FORCES, VOLTAGES

logger = logging.getLogger(__name__)

# Largest value in any unit of a sensor: scaled to newtons, it is still a finite number.
LARGEST: Final = 1e30
# Greatest force of a pulse, at a wrist or a finger: twice the highest `preload` or `peak_to_peak`.
MOST_N: Final = 20.0
# Forces less than this below 0 N are rounding and noise.
NEGLIGIBLE_N: Final = 1e-3
# Greatest share of samples below 0 N that may be intended: noise, a drifting base line.
MOST_BELOW: Final = 0.1
RATE_TOLERANCE: Final = 0.02
# Tolerance of a rate that a stream declares, which is often rounded.
DECLARED_RATE_TOLERANCE: Final = 0.1
SETTLED_S: Final = 2.0
# A longer time without samples than this, and than so many nominal periods of each of those that
# end it, is a pause of the device and no slow rate.
PAUSE_NS: Final = 250_000_000
PAUSE_RATIO: Final = 10
STILL_S: Final = 5.0


def is_usable(value: float) -> bool:
    """Return whether a value, in any unit, is a number that can be scaled."""
    return abs(value) <= LARGEST


def unit_contradiction(stated: str | None, unit: str) -> str | None:
    """Return the contradiction of a device's stated unit to the scene's, and advice; or None.

    Counts are not compared, since the scene has their scale.
    """
    known = FORCES | VOLTAGES
    if stated not in known or unit not in known or stated == unit:
        return None
    return f'is in {stated}, the scene says unit = "{unit}"; set unit = "{stated}"'


def rate_contradiction(stated_hz: float, rate_hz: float) -> str | None:
    """Return the contradiction of a stream's stated rate (0 Hz: none) to the scene's, or None."""
    if not stated_hz or abs(rate_hz / stated_hz - 1) <= DECLARED_RATE_TOLERANCE:
        return None
    return f"its rate is {stated_hz:g} Hz, the scene says {rate_hz:g}"


class RateCheck:
    """Comparison of a live sensor's rate with the nominal one, in Hz. Pure.

    The rate of its timeline, which removes the jitter, shows whether it is wrong. That rate is
    bounded, so the rate that a fault names is counted.
    """

    def __init__(self, nominal_hz: float) -> None:
        self._nominal_hz = nominal_hz
        self._arrived_ns: int | None = None
        # Samples while the timeline's rate was wrong, and the time in which they came.
        self._samples = self._span_ns = 0

    def add(self, samples: int, arrival_ns: int, timeline_hz: float) -> None:
        """Take the number of new samples, those counted as lost included, and their arrival."""
        # The first samples may have waited for long, so their own time is unknown.
        passed_ns = None if self._arrived_ns is None else arrival_ns - self._arrived_ns
        self._arrived_ns = arrival_ns
        longest_ns = PAUSE_NS + PAUSE_RATIO * samples * 1e9 / self._nominal_hz
        if not self._is_wrong(timeline_hz):
            self._samples = self._span_ns = 0
        elif passed_ns is not None and passed_ns <= longest_ns:
            self._samples += samples
            self._span_ns += passed_ns

    def fault(self, name: str) -> str | None:
        """Return the fault of a rate that has been wrong for 2 s, or None."""
        if self._span_ns < SETTLED_S * 1e9:
            return None
        rate_hz = self._samples * 1e9 / self._span_ns
        if not self._is_wrong(rate_hz):
            return None
        scene = f"the scene says {self._nominal_hz:g} Hz"
        return f"{name} sends {rate_hz:.0f} Hz, {scene}: check its rate"

    def _is_wrong(self, rate_hz: float) -> bool:
        return abs(rate_hz / self._nominal_hz - 1) > RATE_TOLERANCE


class SampleCheck:
    """Count of implausible samples of each channel; the first of each kind is logged.

    Forces must be those of a pulse. Any channel must change.
    """

    def __init__(self, period_ns: int, channels: Sequence[Channel]) -> None:
        several = len(channels) > 1
        self._checks = [
            ChannelCheck(channel, period_ns * 1e-9, f"{channel.name}: " if several else "")
            for channel in channels
        ]
        self._logged: set[tuple[str, str]] = set()

    def add(self, values: NDArray[np.float64]) -> None:
        """Check consecutive samples, shape (samples, channels)."""
        if not len(values):
            return
        # Lists are quicker than arrays for a batch of few samples.
        for check, samples in zip(self._checks, values.T.tolist(), strict=True):
            if check.add(samples):
                for kind, fault in check.faults():
                    if (check.prefix, kind) not in self._logged:
                        self._logged.add((check.prefix, kind))
                        logger.warning(fault)

    def faults(self) -> list[str]:
        """Return the faults so far, one line each."""
        return [fault for check in self._checks for _, fault in check.faults()]


class ChannelCheck:
    """Count of the implausible samples of one channel.

    prefix: begins each fault, to name the channel where there are several.
    """

    def __init__(self, channel: Channel, period_s: float, prefix: str) -> None:
        self._period_s, self.prefix = period_s, prefix
        self._is_force = channel.unit == "N"
        self._last: float | None = None
        self._samples = self._beyond = self._below = 0
        self._still = self._longest_still = 0

    def add(self, samples: list[float]) -> bool:
        """Check consecutive samples; return whether any so far may be implausible."""
        # `min` may miss a NaN, the sum does not.
        lowest, highest = min(samples), max(samples)
        if not math.isfinite(sum(samples)):
            lowest = highest = math.nan
        self._samples += len(samples)
        # Both conditions are also true for NaN.
        if self._is_force and not -MOST_N <= lowest <= highest <= MOST_N:
            self._beyond += sum(not abs(sample) <= MOST_N for sample in samples)
        if self._is_force and not lowest >= -NEGLIGIBLE_N:
            self._below += sum(sample < -NEGLIGIBLE_N for sample in samples)
        if lowest == highest and self._last in (None, lowest):
            self._still += len(samples)
            self._longest_still = max(self._longest_still, self._still)
        else:
            self._still = 0
        self._last = samples[-1]
        return bool(self._beyond or self._below or self._longest_still)

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield kind and text of each fault so far."""
        if self._beyond:
            yield (
                "beyond",
                f"{self.prefix}{count_text(self._beyond, 'sample')} beyond {MOST_N:g} N, which no"
                " pulse reaches: check unit and scale in [sensing.source]",
            )
        share = self._below / self._samples if self._samples else 0.0
        if share > MOST_BELOW and self._samples * self._period_s >= SETTLED_S:
            yield (
                "below",
                f"{self.prefix}{count_text(self._below, 'sample')} ({100 * share:.0f} %) below 0 N,"
                " which no display can play: set a higher preload in [sensing.source], or check"
                " the sign",
            )
        still_s = self._longest_still * self._period_s
        if still_s >= STILL_S:
            what = "the force" if self._is_force else "the signal"
            yield (
                "still",
                f"{self.prefix}{what} did not change for {still_s:.1f} s: check the sensor",
            )
