"""A recording as a source: columns of a CSV or NumPy file, played once or in a loop."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from protocol.config.quantities import MAX_NAME, Hertz, Newtons
from protocol.errors import SourceError
from protocol.wire.messages import LARGEST_N
from protocol.wire.stream import ANNOUNCE, PULSE, Channel, first_repeated
from pulse_sensors.force_scale import FORCES, MILLIVOLTS, VOLTAGES, SensitivityTable
from pulse_sensors.plausibility import RecordedColumn, constant_column, examine
from sensing_node.sources.column_files import ColumnKey, load_columns
from sensing_node.sources.source import SampleSource, SourceContext, SourceScene
from sensing_node.sources.synthetic import SyntheticScene


class RecordingScene(SensitivityTable, SourceScene):
    """The `source` table of kind "recording".

    path: .csv, .npy or .npz, relative to the scene's folder. column: a name in the CSV's first line
    (or an array's name in the .npz), or a number from 0. columns: several of them; each is a
    channel with the column's name. announce: column of an ECG, in announce_unit, which becomes the
    channel "announce". unit: N or mN are used unchanged. V or mV are converted by the film: by
    film_radius with eq 21, or by sensitivity, such as 44 mV/N. "raw" is scaled to peak_to_peak,
    each column by itself, with the mean at preload. inverted: the values fall where the pulse
    presses. preload: added force; by default 0.3 N for "raw", as for a synthetic pulse, else 0 N.
    """

    kind: Literal["recording"]
    path: Path
    rate_hz: Annotated[Hertz, Field(ge=1, le=100_000)]
    unit: Literal["N", "mN", "V", "mV", "raw"]
    column: ColumnKey = 0
    columns: Annotated[tuple[ColumnKey, ...], Field(min_length=1, max_length=16)] | None = None
    announce: ColumnKey | None = None
    announce_unit: Literal["V", "mV", "uV"] = "mV"
    peak_to_peak_n: Annotated[Newtons, Field(gt=0, le=10)] | None = None
    preload_n: Annotated[Newtons, Field(ge=0, le=10)] | None = None
    inverted: bool = False
    repeat: Literal["loop", "once"] = "loop"

    @model_validator(mode="after")
    def _has_a_scale(self) -> Self:
        self.refuse_keys_beside(self.unit)
        if self.unit in VOLTAGES and not {"sensitivity", "film_radius"} & self.given:
            raise ValueError(
                f'unit "{self.unit}" needs film_radius or sensitivity to become a force'
            )
        if self.unit == "raw" and self.peak_to_peak_n is None:
            raise ValueError('unit "raw" needs peak_to_peak to become a force')
        if {"column", "columns"} <= self.given:
            raise ValueError("column is one, columns are several; give one of the two keys")
        if "announce_unit" in self.given and self.announce is None:
            raise ValueError("announce_unit needs announce, which is not given")
        return self

    def build(self, context: SourceContext) -> "RecordedSource":
        """See `SourceScene.build`."""
        return RecordedSource(self, context.folder, context.plausible)

    @property
    def forces_of(self) -> tuple[ColumnKey, ...]:
        """Columns of the pulse."""
        return (self.column,) if self.columns is None else self.columns

    @property
    def rest_n(self) -> float:
        """Force in N that is added, or that a raw recording's mean becomes."""
        if self.preload_n is not None:
            return self.preload_n
        return SyntheticScene(kind="synthetic").preload_n if self.unit == "raw" else 0.0

    def forces(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return forces in N, shape (samples,), for values that are not all equal."""
        if self.inverted:
            values = -values
        if self.unit in FORCES:
            return values * FORCES[self.unit] + self.rest_n
        if self.unit in VOLTAGES:
            return self.calibration().newtons(values * VOLTAGES[self.unit]) + self.rest_n
        scale = (self.peak_to_peak_n or 0.0) / float(np.ptp(values))
        return self.rest_n + (values - float(values.mean())) * scale


class RecordedSource(SampleSource):
    """A recorded pulse in N, one channel for each column; `warnings` lists doubtful properties.

    Parameters
    ----------
    folder : Path
        Folder of the scene file.
    plausible : bool
        Refuse values that cannot be a pulse with this scene.

    Raises
    ------
    SourceError
        If the file cannot be read or scaled, or its values are refused.
    """

    def __init__(self, scene: RecordingScene, folder: Path, plausible: bool = True) -> None:
        path = folder / scene.path
        announcing = () if scene.announce is None else (scene.announce,)
        loaded = load_columns(path, (*scene.forces_of, *announcing))
        pulses = loaded[: len(scene.forces_of)]
        self.warnings: list[str] = []
        values = []
        for column in pulses:
            constant = constant_column(column)
            if constant is not None and scene.unit == "raw":
                raise SourceError(f"{path}: {constant}")
            force_n = scene.forces(column.values)
            refusal, warnings = examine(column, force_n, scene.unit, scene.rate_hz, scene.rest_n)
            of_column = f"{column.title}: " if scene.columns else ""
            doubts = [
                f"{path}: {text if text.startswith('column ') else of_column + text}"
                for text in (warnings if refusal is None else [refusal])
            ]
            if refusal is not None and plausible:
                raise SourceError(doubts[0])
            # Those of the file itself are the same for each column.
            self.warnings += [doubt for doubt in doubts if doubt not in self.warnings]
            values.append(force_n)
        for column in loaded[len(pulses) :]:
            values.append(_announcing(column, scene.announce_unit, path))
        self._values = np.stack(values, axis=1)
        self.channels = _channels(scene, pulses, path)
        self._loop = scene.repeat == "loop"
        self._position = 0
        self.period_ns = round(1e9 / scene.rate_hz)

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next samples, shape (count, channels); fewer at the end of one pass."""
        first, length = self._position, len(self._values)
        last = first + count if self._loop else min(first + count, length)
        self._position = last
        return self._values[np.arange(first, last) % length]

    def faults(self) -> list[str]:
        """See `SampleSource.faults`."""
        return list(self.warnings)


def _announcing(column: RecordedColumn, unit: str, path: Path) -> NDArray[np.float64]:
    """Return the samples of a channel that announces, in mV. Raises SourceError."""
    constant = constant_column(column)
    if constant is not None:
        raise SourceError(f"{path}: announce: {constant}")
    millivolts = column.values * MILLIVOLTS[unit]
    largest_mv = float(np.abs(millivolts).max())
    if largest_mv > LARGEST_N:
        raise SourceError(
            f'{path}: announce: {column.title} reaches {largest_mv:.4g} mV in unit "{unit}", which'
            " no frame can hold; set announce_unit"
        )
    return millivolts


def _channels(
    scene: RecordingScene, pulses: Sequence[RecordedColumn], path: Path
) -> tuple[Channel, ...]:
    """Return the channels, named by their columns; one `column` is "pulse". Raises SourceError."""
    names = [PULSE] if scene.columns is None else [c.name or f"column {c.number}" for c in pulses]
    for name in names:
        if not name.isprintable() or len(name) > MAX_NAME:
            raise SourceError(
                f"{path}: columns: the name {ascii(name)[:MAX_NAME]} cannot be a channel's, which"
                f" has at most {MAX_NAME} printable characters; rename the column, or give"
                " its number in a file without names"
            )
    announcing = () if scene.announce is None else (Channel(ANNOUNCE, "mV"),)
    repeated = first_repeated((*names, ANNOUNCE))
    if repeated is not None:
        raise SourceError(
            f"{path}: columns: two channels would have the name {repeated!r}; rename a column"
        )
    return (*(Channel(name) for name in names), *announcing)
