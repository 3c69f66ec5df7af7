"""Model of the feedback film under the finger, from the felt force to a reading.

Force → volts → noise → low-pass → ADC → newtons. Parts that the scene does not name are left out.
"""

import math
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from display_node.plant.filters import delay_line
from display_node.plant.scene import FilmTable
from protocol.tactile import Adc
from protocol.ticks import LimitCounter

NOISE_BLOCK = 1024


class FilmModel:
    """A modelled film that reads the felt force. The same seed gives the same noise.

    Attributes
    ----------
    at_range
        Counter of the ticks in which the ADC's range has bounded the reading; None without an ADC.
    """

    STATE: ClassVar = ("_late", "_low_pass")

    def __init__(self, table: FilmTable, tick_s: float, seed: int = 1) -> None:
        self._low_pass = table.low_pass(tick_s)
        self._late = delay_line(table.latency_ns * 1e-9 / tick_s)
        self._noise = _noise(table.noise_n, seed) if table.noise_n else None
        self._adc = Adc(table.adc_bits, table.adc_range_v) if table.adc_bits else None
        parts = (self._low_pass, self._late, self._noise, self._adc)
        self._ideal = all(part is None for part in parts)
        self._volts_per_newton = table.volts_per_newton
        self.at_range = None if self._adc is None else LimitCounter()

    def read(self, force_n: float) -> float:
        """Return this tick's reading in N for the felt force in N. Call it once a tick.

        NaN and infinity are returned unchanged, so that safety detects them.
        """
        if self._ideal or not math.isfinite(force_n):
            return force_n
        if self._late is not None:
            force_n = self._late.step(force_n)
        if self._noise is not None:
            force_n += next(self._noise)
        if self._low_pass is not None:
            filtered_n = self._low_pass.output(force_n)
            self._low_pass.advance(force_n)
            force_n = filtered_n
        if self._adc is not None and self.at_range is not None:
            volts = force_n * self._volts_per_newton
            self.at_range.add(abs(volts) > self._adc.range_volts)
            force_n = self._adc.quantise(volts) / self._volts_per_newton
        return force_n


def _noise(rms_n: float, seed: int) -> Iterator[float]:
    rng = np.random.default_rng(seed)
    while True:
        yield from (rms_n * rng.standard_normal(NOISE_BLOCK)).tolist()
