"""Conversion from a sensor's own unit to newtons: the keys that every live sensor's table has."""

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field, model_validator

from protocol.config.quantities import Hertz, Metres, Newtons, Volts, VoltsPerNewton
from protocol.config.scene import Section
from protocol.tactile import Calibration, Film

_NEWTONS = {"N": 1.0, "mN": 1e-3}
_VOLTS = {"V": 1.0, "mV": 1e-3}


@dataclass(frozen=True, slots=True)
class ForceScale:
    """A straight line: newtons = newtons_per_unit · (value − zero) + preload_n."""

    newtons_per_unit: float
    zero: float
    preload_n: float

    def newtons(self, values: tuple[float, ...]) -> tuple[float, ...]:
        """Return forces in N for values in the sensor's unit."""
        return tuple(
            self.newtons_per_unit * (value - self.zero) + self.preload_n for value in values
        )


class SensorTable(Section):
    """The keys common to the tables of all live sensors.

    rate: samples a second, nominally; the true one is measured. unit: N or mN as they are; V or
    mV by the film's calibration: sensitivity (Fig. 4: 44 mV/N) or film_radius (eq 21), with
    `offset` at no force; counts by newtons_per_count, with `zero` at no force. preload is added:
    a film cannot tell a static force.
    """

    rate_hz: Annotated[Hertz, Field(ge=1, le=20_000)]
    unit: Literal["N", "mN", "V", "mV", "counts"]
    sensitivity_v_per_n: Annotated[VoltsPerNewton, Field(ge=1e-6, le=1e6)] | None = None
    film_radius_m: Annotated[Metres, Field(ge=1e-6, le=1)] | None = None
    offset_v: Annotated[Volts, Field(ge=-1000, le=1000)] = 0.0
    newtons_per_count: Annotated[float, Field(ge=-1e3, le=1e3)] | None = None
    zero: Annotated[float, Field(ge=-1e10, le=1e10)] = 0.0
    preload_n: Annotated[Newtons, Field(ge=0, le=10)] = 0.0

    @model_validator(mode="after")
    def _scale_is_known(self) -> "SensorTable":
        given = {type(self).model_fields[name].alias for name in self.model_fields_set}
        volts, counts = {"sensitivity", "film_radius", "offset"}, {"newtons_per_count", "zero"}
        if {"sensitivity", "film_radius"} <= given:
            raise ValueError("sensitivity and film_radius both say it; give one of them")
        for keys, units in ((volts, ("V", "mV")), (counts, ("counts",))):
            if keys & given and self.unit not in units:
                key = min(keys & given)
                raise ValueError(f'{key} is for unit {" or ".join(units)}, not "{self.unit}"')
        if self.unit == "counts" and not self.newtons_per_count:
            raise ValueError('unit "counts" needs newtons_per_count, which is not 0')
        return self

    @property
    def period_ns(self) -> int:
        """Time between samples, nominally."""
        return round(1e9 / self.rate_hz)

    def contradicts(self, stated_unit: str | None) -> bool:
        """Return whether a device states another unit of force or voltage than the table's.

        Counts are left alone: their scale is a calibration of its own.
        """
        known = (*_NEWTONS, *_VOLTS)
        return stated_unit in known and self.unit in known and stated_unit != self.unit

    def force_scale(self) -> ForceScale:
        """Return the line that the table describes."""
        if self.unit == "counts":
            return ForceScale(self.newtons_per_count or 0.0, self.zero, self.preload_n)
        if self.unit in _NEWTONS:
            return ForceScale(_NEWTONS[self.unit], 0.0, self.preload_n)
        line = self._calibration()
        volts = _VOLTS[self.unit]
        return ForceScale(volts / line.volts_per_newton, line.offset_volts / volts, self.preload_n)

    def _calibration(self) -> Calibration:
        if self.film_radius_m is not None:
            return Calibration(Film(self.film_radius_m).volts_per_newton, self.offset_v)
        if self.sensitivity_v_per_n is not None:
            return Calibration(self.sensitivity_v_per_n, self.offset_v)
        return Calibration(offset_volts=self.offset_v)
