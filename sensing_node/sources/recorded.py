"""A recording as a source: CSV and NumPy files, looped or once."""

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from protocol.config.quantities import Hertz, Metres, Newtons, VoltsPerNewton
from protocol.config.scene import Section
from protocol.errors import SourceError
from protocol.tactile import Calibration, Film
from protocol.wire.stream import Channel
from sensing_node.sources.plausibility import (
    refuse_constant,
    refuse_forces,
    refuse_rate,
    refuse_times,
    warn_of_forces,
    warn_of_gaps,
)
from sensing_node.sources.recording_file import load_column
from sensing_node.sources.synthetic import SyntheticScene

NEWTONS_PER_UNIT = {"N": 1.0, "mN": 1e-3}
VOLTS_PER_UNIT = {"V": 1.0, "mV": 1e-3}
# The keys of each kind of unit; a key of another one would be passed over.
_SCALES = {
    "film_radius": tuple(VOLTS_PER_UNIT),
    "sensitivity": tuple(VOLTS_PER_UNIT),
    "peak_to_peak": ("raw",),
}


class RecordingScene(Section):
    """The `source` table of kind "recording".

    path: .csv, .npy or .npz, from the scene's folder. column: a name in the CSV's first line
    (or an array's name in the .npz), or a number from 0. unit: N or mN as they are; V or mV
    through the film (eq 21 with film_radius, or sensitivity, as Fig. 4's 44 mV/N); raw, scaled to
    `peak_to_peak` with the mean on `preload`. inverted: the pulse presses where the values fall.
    preload: added; without, 0.3 N for raw, as for a synthetic pulse, else 0 N.
    """

    kind: Literal["recording"]
    path: Path
    rate_hz: Annotated[Hertz, Field(ge=1, le=100_000)]
    unit: Literal["N", "mN", "V", "mV", "raw"]
    column: Annotated[int, Field(ge=0)] | str = 0
    film_radius_m: Annotated[Metres, Field(ge=1e-6, le=1)] | None = None
    sensitivity_v_per_n: Annotated[VoltsPerNewton, Field(ge=1e-6, le=1e6)] | None = None
    peak_to_peak_n: Annotated[Newtons, Field(gt=0, le=10)] | None = None
    preload_n: Annotated[Newtons, Field(ge=0, le=10)] | None = None
    inverted: bool = False
    repeat: Literal["loop", "once"] = "loop"

    @model_validator(mode="after")
    def _scale_is_known(self) -> "RecordingScene":
        given = {type(self).model_fields[name].alias for name in self.model_fields_set}
        for key, units in _SCALES.items():
            if key in given and self.unit not in units:
                raise ValueError(f'{key} is for unit {" or ".join(units)}, not "{self.unit}"')
        if {"sensitivity", "film_radius"} <= given:
            raise ValueError("sensitivity and film_radius both say it; give one of them")
        if self.unit in VOLTS_PER_UNIT and not {"sensitivity", "film_radius"} & given:
            raise ValueError(
                f'unit "{self.unit}" needs film_radius or sensitivity to become a force'
            )
        if self.unit == "raw" and self.peak_to_peak_n is None:
            raise ValueError('unit "raw" needs peak_to_peak to become a force')
        return self

    @property
    def rest_n(self) -> float:
        """Force in N that is added, or on which a raw recording's mean is put."""
        if self.preload_n is not None:
            return self.preload_n
        return SyntheticScene(kind="synthetic").preload_n if self.unit == "raw" else 0.0

    def forces(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return forces in N of a recording's values, not all of which are equal."""
        if self.inverted:
            values = -values
        if self.unit in NEWTONS_PER_UNIT:
            return values * NEWTONS_PER_UNIT[self.unit] + self.rest_n
        if self.unit in VOLTS_PER_UNIT:
            return self._calibration().newtons(values * VOLTS_PER_UNIT[self.unit]) + self.rest_n
        scale = (self.peak_to_peak_n or 0.0) / float(np.ptp(values))
        return self.rest_n + (values - float(values.mean())) * scale

    def _calibration(self) -> Calibration:
        if self.film_radius_m is not None:
            return Calibration.of_film(Film(self.film_radius_m))
        return Calibration(self.sensitivity_v_per_n or 0.0)


class RecordedSource:
    """A recorded pulse in newtons, given sample by sample.

    warnings: what is doubtful about it, one line each.
    """

    channels = (Channel("pulse"),)

    def __init__(self, scene: RecordingScene, folder: Path, plausible: bool = True) -> None:
        """Read the recording.

        Raises SourceError for a file that cannot be read or scaled, and, where it must be
        `plausible`, for values that cannot be a pulse's by this scene.
        """
        path = folder / scene.path
        column = load_column(path, scene.column)
        constant = refuse_constant(column)
        if constant is not None and (plausible or scene.unit == "raw"):
            raise SourceError(f"{path}: {constant}")
        force_n, scale = scene.forces(column.values), (scene.unit, scene.rest_n)
        reason = (
            constant
            or refuse_times(column)
            or refuse_rate(column, scene.rate_hz)
            or refuse_forces(force_n, *scale)
        )
        if reason is not None and plausible:
            raise SourceError(f"{path}: {reason}")
        doubts = [reason] if reason else warn_of_gaps(column) + warn_of_forces(force_n, *scale)
        self.warnings = [f"{path}: {doubt}" for doubt in doubts]
        self._force_n = force_n
        self._loop = scene.repeat == "loop"
        self._position = 0
        self.period_ns = round(1e9 / scene.rate_hz)

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next samples in N, shape (count, 1); fewer at the end of one pass."""
        first, length = self._position, len(self._force_n)
        last = first + count if self._loop else min(first + count, length)
        self._position = last
        return self._force_n[np.arange(first, last) % length, np.newaxis]
