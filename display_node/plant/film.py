"""Model of the feedback film under the finger, from the felt force to a reading.

Force → volts → noise → low-pass → ADC → newtons. Parts that the scene does not name are left out.
"""

import math
from collections.abc import Iterator
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from display_node.plant.filters import LowPass, delay_line
from protocol.config.quantities import Hertz, Metres, Nanoseconds, Newtons, Volts, VoltsPerNewton
from protocol.config.scene import Section
from protocol.counters import LimitCounter
from protocol.tactile import Adc, Film

NOISE_BLOCK = 1024


class FilmTable(Section):
    """The `film` table: the PVDF film under the finger (Table 1 of Dargahi et al. 2008: 9 mm).

    sensitivity: that of the film with its amplifier, such as 44 mV/N in Fig. 4; by default eq 21
    gives it from the radius. filter: corner of the low-pass of `filter_order` poles behind the
    film. noise: RMS before the filter. adc_bits: resolution over ±adc_range. latency: age of a
    reading when it is read.
    """

    radius_m: Annotated[Metres, Field(gt=0)] = 9e-3
    sensitivity_v_per_n: Annotated[VoltsPerNewton, Field(gt=0)] | None = None
    filter_hz: Annotated[Hertz, Field(gt=0)] | None = None
    filter_order: Annotated[int, Field(ge=1, le=4)] = 1
    noise_n: Annotated[Newtons, Field(ge=0, le=10)] = 0.0
    adc_bits: Annotated[int, Field(ge=2, le=32)] | None = None
    adc_range_v: Annotated[Volts, Field(gt=0)] = 10.0
    latency_ns: Annotated[Nanoseconds, Field(ge=0, le=50_000_000)] = 0

    @property
    def volts_per_newton(self) -> float:
        """Voltage at the ADC per newton."""
        return self.sensitivity_v_per_n or Film(self.radius_m).volts_per_newton

    @property
    def millivolts_per_newton(self) -> float:
        """Scale of the paper's gains in mV/N: that of eq 21, without the amplifier."""
        return 1e3 * Film(self.radius_m).volts_per_newton

    @property
    def noise_with_adc_n(self) -> float:
        """RMS error of a reading in N: noise and the ADC's rounding."""
        if self.adc_bits is None:
            return self.noise_n
        step_n = Adc(self.adc_bits, self.adc_range_v).step_volts / self.volts_per_newton
        return math.hypot(self.noise_n, step_n / math.sqrt(12))

    def low_pass(self, tick_s: float) -> LowPass | None:
        """Return the model of the filter behind the film; None without a filter."""
        return LowPass(self.filter_hz, self.filter_order, tick_s) if self.filter_hz else None


class FeedbackFilm:
    """A film that reads the felt force. The same seed gives the same noise.

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
        self._volts_per_newton = table.volts_per_newton
        self.at_range = None if self._adc is None else LimitCounter()

    def read(self, force_n: float) -> float:
        """Return this tick's reading in N for the felt force in N. Call it once a tick.

        NaN and infinity are returned unchanged, so that safety detects them.
        """
        if not math.isfinite(force_n):
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
