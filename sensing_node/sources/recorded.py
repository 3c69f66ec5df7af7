"""A recording as a source: one column of a CSV or NumPy file, played once or in a loop."""

import csv
import math
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from protocol.config.quantities import Hertz, Newtons
from protocol.errors import SourceError
from protocol.wire.stream import Channel
from pulse_sensors.force_scale import FORCES, VOLTAGES, SensitivityTable
from pulse_sensors.plausibility import RecordedColumn, constant_column, examine, unusable_values
from sensing_node.sources.synthetic import SyntheticScene


class RecordingScene(SensitivityTable):
    """The `source` table of kind "recording".

    path: .csv, .npy or .npz, relative to the scene's folder. column: a name in the CSV's first line
    (or an array's name in the .npz), or a number from 0. unit: N or mN are used unchanged. V or mV
    are converted by the film: by film_radius with eq 21, or by sensitivity, such as 44 mV/N. "raw"
    is scaled to peak_to_peak, with the mean at preload. inverted: the values fall where the pulse
    presses. preload: added force; by default 0.3 N for "raw", as for a synthetic pulse, else 0 N.
    """

    kind: Literal["recording"]
    path: Path
    rate_hz: Annotated[Hertz, Field(ge=1, le=100_000)]
    unit: Literal["N", "mN", "V", "mV", "raw"]
    column: Annotated[int, Field(ge=0)] | str = 0
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
        return self

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


class RecordedSource:
    """A recorded pulse in N, with one channel; `warnings` lists its doubtful properties.

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

    channels = (Channel("pulse"),)

    def __init__(self, scene: RecordingScene, folder: Path, plausible: bool = True) -> None:
        path = folder / scene.path
        column = load_column(path, scene.column)
        constant = constant_column(column)
        if constant is not None and scene.unit == "raw":
            raise SourceError(f"{path}: {constant}")
        self._force_n = scene.forces(column.values)
        scaled = (self._force_n, scene.unit, scene.rate_hz, scene.rest_n)
        refusal, warnings = examine(column, *scaled)
        if refusal is not None and plausible:
            raise SourceError(f"{path}: {refusal}")
        doubts = warnings if refusal is None else [refusal]
        self.warnings = [f"{path}: {doubt}" for doubt in doubts]
        self._loop = scene.repeat == "loop"
        self._position = 0
        self.period_ns = round(1e9 / scene.rate_hz)

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next samples in N, shape (count, 1); fewer at the end of one pass."""
        first, length = self._position, len(self._force_n)
        last = first + count if self._loop else min(first + count, length)
        self._position = last
        return self._force_n[np.arange(first, last) % length, np.newaxis]


def load_column(path: Path, column: int | str) -> RecordedColumn:
    """Return one column of a file.

    Parameters
    ----------
    path : Path
        A .csv, .txt, .npy or .npz file.
    column : int or str
        Number from 0, or name.

    Raises
    ------
    SourceError
        If the file cannot be read, or the column is missing or has no usable numbers.
    """
    try:
        match path.suffix.lower():
            case ".csv" | ".txt":
                loaded = _load_csv(path, column)
            case ".npy" | ".npz":
                loaded = _load_numpy(path, column)
            case suffix:
                raise SourceError(f"{path}: {suffix or 'no suffix'} is not .csv, .npy or .npz")
    except SourceError:
        raise
    except FileNotFoundError:
        raise SourceError(f"{path}: no such recording") from None
    except Exception as error:  # NumPy, zipfile and csv raise many kinds for a damaged file
        lines = str(getattr(error, "strerror", None) or error).splitlines()
        reason = lines[0] if lines else type(error).__name__
        raise SourceError(f"{path}: cannot be read: {reason}") from None
    unusable = unusable_values(loaded.values)
    if unusable is not None:
        raise SourceError(f"{path}: {unusable}")
    return loaded


def _load_csv(path: Path, column: int | str) -> RecordedColumn:
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file)
        first = [name.strip() for name in next(rows, [])]
        if not first:
            raise SourceError(f"{path}: is empty, or its first line is")
        if isinstance(column, str) and column not in first:
            raise SourceError(f"{path}: no column {column!r}; it has {', '.join(first)[:200]}")
        number = first.index(column) if isinstance(column, str) else column
        if number >= len(first):
            raise SourceError(f"{path}: no column {column}; it has {len(first)}")
        has_header = isinstance(column, str) or _number(first[number]) is None
        # Other columns whose values have not fallen yet; a pulse falls within a beat.
        rising: dict[int, list[float]] = {at: [] for at in range(len(first)) if at != number}
        values: list[float] = []

        def add(row: list[str]) -> None:
            where = f"{path}: line {rows.line_num}"
            if number >= len(row):
                raise SourceError(f"{where}: no column {number}; it has {len(row)}")
            value = _number(row[number])
            if value is None:
                raise SourceError(f"{where}: {row[number][:40]!r} is not a number")
            values.append(value)
            for place, kept in list(rising.items()):
                time = _time(row[place]) if place < len(row) else None
                if time is None or (kept and not time >= kept[-1]):
                    del rising[place]
                else:
                    kept.append(time)

        if not has_header:
            add(first)
        for row in rows:
            if row:
                add(row)
    names = first if has_header else [""] * len(first)
    return RecordedColumn(
        np.array(values, dtype=np.float64),
        number,
        names[number],
        tuple(name for place, name in enumerate(names) if place != number),
        {names[place] or str(place): np.array(kept) for place, kept in rising.items()},
    )


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _time(text: str) -> float | None:
    """Return the finite number in a text, the Unix time of a date in ISO 8601, or None."""
    number = _number(text)
    if number is not None:
        return number if math.isfinite(number) else None
    try:
        return datetime.fromisoformat(text.strip()).timestamp()
    except (ValueError, OverflowError):
        return None


def _load_numpy(path: Path, column: int | str) -> RecordedColumn:
    """Return a column of an .npy or an array of an .npz; the file's first bytes decide which."""
    with path.open("rb") as file:
        loaded = np.load(file, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            return _column_of(loaded, column, path)
        with loaded:
            names = list(loaded)
            if isinstance(column, int) and column < len(names):
                column = names[column]
            if column not in names:
                raise SourceError(f"{path}: no array {column!r}; it has {', '.join(names)[:200]}")
            name = str(column)
            values = _column_of(np.asarray(loaded[name]), 0, path).values
            beside = {other: np.asarray(loaded[other]) for other in names if other != name}
    rising = _rising(beside, len(values))
    return RecordedColumn(values, names.index(name), name, tuple(beside), rising)


def _column_of(array: NDArray[Any], column: int | str, path: Path) -> RecordedColumn:
    if array.ndim not in (1, 2) or array.dtype.kind not in "iuf":
        raise SourceError(
            f"{path}: needs real numbers in one or two dimensions,"
            f" has {array.dtype} in {array.ndim}"
        )
    table = array[:, np.newaxis] if array.ndim == 1 else array
    if not isinstance(column, int) or column >= table.shape[1]:
        raise SourceError(f"{path}: no column {column!r}; it has {table.shape[1]}")
    # NumPy warns of signalling NaN, which are refused later like other NaN.
    with np.errstate(invalid="ignore"):
        values = np.ascontiguousarray(table[:, column], dtype=np.float64)
        beside = {str(at): table[:, at] for at in range(table.shape[1]) if at != column}
        rising = _rising(beside, len(values))
    return RecordedColumn(values, column, others=("",) * len(beside), rising=rising)


def _rising(arrays: dict[str, NDArray[Any]], length: int) -> dict[str, NDArray[np.float64]]:
    """Return the arrays that have a given length and never fall."""
    return {
        name: array.astype(np.float64)
        for name, array in arrays.items()
        if array.shape == (length,)
        and array.dtype.kind in "iuf"
        and bool(np.isfinite(array).all())
        and bool(np.all(array[1:] >= array[:-1]))
    }
