"""Scale from a sensor's unit to newtons, and the keys for it that all sensor tables have."""

from collections.abc import Mapping
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from protocol.config.quantities import (
    Hertz,
    Metres,
    Name,
    Newtons,
    Volts,
    VoltsPerNewton,
    count_text,
)
from protocol.config.scene import Section
from protocol.tactile import FIG_4_VOLTS_PER_NEWTON, Calibration, Film
from protocol.wire.description import ANNOUNCE, PULSE, Channel, first_repeated

# Most values of a sample.
MAX_VALUES = 15
# Units that a scene may use, in N, in V, and of a channel that announces in mV.
FORCES = {"N": 1.0, "mN": 1e-3}
VOLTAGES = {"V": 1.0, "mV": 1e-3}
MILLIVOLTS = {"V": 1e3, "mV": 1.0, "uV": 1e-3, "counts": 1.0}
# Keys that are valid with some units only, in the order of their check.
UNITS_OF: Mapping[str, tuple[str, ...]] = {
    **dict.fromkeys(("film_radius", "offset", "sensitivity"), tuple(VOLTAGES)),
    **dict.fromkeys(("newtons_per_count", "zero"), ("counts",)),
    "peak_to_peak": ("raw",),
}


class SensitivityTable(Section):
    """Base of tables with a film: sensitivity (Fig. 4: 44 mV/N), or film_radius with eq 21.

    Figures and equations are those of Dargahi et al. (2008).
    """

    sensitivity_v_per_n: Annotated[VoltsPerNewton, Field(ge=1e-6, le=1e6)] | None = None
    film_radius_m: Annotated[Metres, Field(ge=1e-6, le=1)] | None = None

    @property
    def given(self) -> set[str | None]:
        """Keys that the scene sets."""
        return {type(self).model_fields[name].alias for name in self.model_fields_set}

    @model_validator(mode="after")
    def _has_one_sensitivity(self) -> Self:
        if {"sensitivity", "film_radius"} <= self.given:
            raise ValueError("sensitivity and film_radius both set the scale; give one of them")
        return self

    def refuse_keys_beside(self, unit: str) -> None:
        """Raise ValueError for a given key that is not valid with a unit."""
        for key, units in UNITS_OF.items():
            if key in self.given and unit not in units:
                raise ValueError(f'{key} is for unit {" or ".join(units)}, not "{unit}"')

    def calibration(self, offset_volts: float = 0.0) -> Calibration:
        """Return the line from newtons to volts, by default that of Fig. 4."""
        if self.film_radius_m is not None:
            return Calibration(Film(self.film_radius_m).volts_per_newton, offset_volts)
        return Calibration(self.sensitivity_v_per_n or FIG_4_VOLTS_PER_NEWTON, offset_volts)


class SensorTable(SensitivityTable):
    """The keys common to the tables of all live sensors.

    rate: nominal samples a second; the true rate is measured. unit: N or mN are used unchanged. V
    or mV are converted by the film's calibration, sensitivity or film_radius, with `offset` as the
    voltage at no force. Counts are converted by newtons_per_count, with `zero` at no force.
    preload: added force, because a film does not measure a static force. names: of the channels,
    where a sample has several values. The one named "announce" is an ECG or the like: it has
    announce_unit, and no scale but that (counts are sent unchanged).
    """

    rate_hz: Annotated[Hertz, Field(ge=1, le=20_000)]
    unit: Literal["N", "mN", "V", "mV", "counts"]
    offset_v: Annotated[Volts, Field(ge=-1000, le=1000)] = 0.0
    newtons_per_count: Annotated[float, Field(ge=-1e3, le=1e3)] | None = None
    zero: Annotated[float, Field(ge=-1e10, le=1e10)] = 0.0
    preload_n: Annotated[Newtons, Field(ge=0, le=10)] = 0.0
    names: Annotated[tuple[Name, ...], Field(min_length=1, max_length=MAX_VALUES)] | None = None
    announce_unit: Literal["V", "mV", "uV", "counts"] = "mV"

    @model_validator(mode="after")
    def _has_a_scale(self) -> Self:
        self.refuse_keys_beside(self.unit)
        if self.unit == "counts" and not self.newtons_per_count:
            raise ValueError('unit "counts" needs newtons_per_count, which is not 0')
        return self

    @model_validator(mode="after")
    def _names_its_values(self) -> Self:
        names, values = self.names or self.value_names, len(self.value_names)
        if len(names) != values:
            raise ValueError(
                f"names gives {count_text(len(names), 'name')}, and a sample has"
                f" {count_text(values, 'value')}"
            )
        repeated = first_repeated(names)
        if repeated is not None:
            raise ValueError(f"two channels have the name {repeated!r}")
        if set(names) == {ANNOUNCE}:
            raise ValueError(f"the only channel is {ANNOUNCE!r}; a pulse needs a channel of force")
        if "announce_unit" in self.given and ANNOUNCE not in names:
            raise ValueError(f'announce_unit is for a channel named "{ANNOUNCE}", and none is')
        return self

    @property
    def value_names(self) -> tuple[str, ...]:
        """Names of a sample's values, in order, where the scene gives none."""
        return (PULSE,)

    @property
    def wire_channels(self) -> tuple[Channel, ...]:
        """Channels of the sensor, one for each value of a sample."""
        names = self.names or self.value_names
        return tuple(Channel(name, "mV" if name == ANNOUNCE else "N") for name in names)

    @property
    def period_ns(self) -> int:
        """Nominal time between samples."""
        return round(1e9 / self.rate_hz)

    def newtons(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return forces in N, of the same shape, for values in the table's unit."""
        if self.unit == "counts":
            newtons_per_unit, zero = self.newtons_per_count or 0.0, self.zero
        elif self.unit in VOLTAGES:
            line, volts = self.calibration(self.offset_v), VOLTAGES[self.unit]
            newtons_per_unit, zero = volts / line.volts_per_newton, line.offset_volts / volts
        else:
            newtons_per_unit, zero = FORCES[self.unit], 0.0
        return newtons_per_unit * (values - zero) + self.preload_n
