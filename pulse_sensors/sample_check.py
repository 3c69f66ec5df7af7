"""Plausibility of the samples of a running source, channel by channel."""

import logging
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from protocol.config.quantities import count_text
from protocol.wire.description import Channel
from pulse_sensors.plausibility import MOST_BELOW, MOST_N, NEGLIGIBLE_N, SETTLED_S

logger = logging.getLogger(__name__)

STILL_S = 5.0


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
