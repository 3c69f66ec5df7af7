"""A recording as a source: CSV and NumPy files, looped or once."""

import csv
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from protocol.errors import SourceError
from protocol.quantities import Hertz, Metres, Newtons
from protocol.scene import Section
from protocol.stream import Channel
from protocol.tactile import Film

NEWTONS_PER_UNIT = {"N": 1.0, "mN": 1e-3}
VOLTS_PER_UNIT = {"V": 1.0, "mV": 1e-3}
# No unit of a recording takes a value of this size beyond what float32 holds.
LARGEST = 1e30
# What differs by less is equal, and is not stretched to anything.
SMALLEST = 1e-100


class RecordingScene(Section):
    """The `source` table of kind "recording".

    path: .csv, .npy or .npz, from the scene's folder. column: a name in the CSV's first line
    (or an array's name in the .npz), or a number from 0. unit: N or mN as they are; V or mV
    through the film (eq 21, needs film_radius); raw, scaled to `peak_to_peak` on `preload`.
    """

    kind: Literal["recording"]
    path: Path
    rate_hz: Annotated[Hertz, Field(ge=1, le=100_000)]
    unit: Literal["N", "mN", "V", "mV", "raw"]
    column: Annotated[int, Field(ge=0)] | str = 0
    film_radius_m: Annotated[Metres, Field(ge=1e-6, le=1)] | None = None
    peak_to_peak_n: Annotated[Newtons, Field(gt=0, le=10)] | None = None
    preload_n: Annotated[Newtons, Field(ge=0, le=10)] = 0.0
    repeat: Literal["loop", "once"] = "loop"

    @model_validator(mode="after")
    def _scale_is_known(self) -> "RecordingScene":
        if self.unit in VOLTS_PER_UNIT and self.film_radius_m is None:
            raise ValueError(f'unit "{self.unit}" needs film_radius to become a force')
        if self.unit == "raw" and self.peak_to_peak_n is None:
            raise ValueError('unit "raw" needs peak_to_peak to become a force')
        return self


class Recording:
    """Gives a recorded pulse in newtons, sample by sample."""

    channels = (Channel("pulse"),)

    def __init__(self, scene: RecordingScene, folder: Path) -> None:
        path = folder / scene.path
        self._force_n = _in_newtons(scene, _load(path, scene.column), path)
        self._loop = scene.repeat == "loop"
        self._position = 0
        self.period_ns = round(1e9 / scene.rate_hz)

    def take(self, count: int) -> NDArray[np.float64]:
        """The next samples in N, shape (count, 1); fewer only when played once and at its end."""
        first, length = self._position, len(self._force_n)
        last = first + count if self._loop else min(first + count, length)
        self._position = last
        return self._force_n[np.arange(first, last) % length, np.newaxis]


def _in_newtons(
    scene: RecordingScene, values: NDArray[np.float64], path: Path
) -> NDArray[np.float64]:
    if scene.unit in NEWTONS_PER_UNIT:
        return values * NEWTONS_PER_UNIT[scene.unit] + scene.preload_n
    if scene.film_radius_m is not None and scene.unit in VOLTS_PER_UNIT:
        volts = values * VOLTS_PER_UNIT[scene.unit]
        return Film(scene.film_radius_m).newtons(volts) + scene.preload_n
    span = float(np.ptp(values))
    if span < SMALLEST or scene.peak_to_peak_n is None:
        raise SourceError(f"{path}: all values are equal; nothing to scale to peak_to_peak")
    return scene.preload_n + (values - float(values.mean())) * (scene.peak_to_peak_n / span)


def _load(path: Path, column: int | str) -> NDArray[np.float64]:
    """One column of a file as usable float64. Raises SourceError."""
    try:
        match path.suffix.lower():
            case ".csv" | ".txt":
                values = _load_csv(path, column)
            case ".npy" | ".npz":
                values = _load_numpy(path, column)
            case suffix:
                raise SourceError(f"{path}: {suffix or 'no suffix'} is not .csv, .npy or .npz")
    except SourceError:
        raise
    except FileNotFoundError:
        raise SourceError(f"{path}: no such recording") from None
    except Exception as error:  # damaged, it raises whatever NumPy, zipfile or csv stumble over
        lines = str(getattr(error, "strerror", None) or error).splitlines()
        reason = lines[0] if lines else type(error).__name__
        raise SourceError(f"{path}: cannot be read: {reason}") from None
    if len(values) < 2:
        raise SourceError(f"{path}: number of samples is {len(values)}; it must be 2 or more")
    bad = np.flatnonzero(~(np.abs(values) <= LARGEST))
    if len(bad):
        raise SourceError(
            f"{path}: {len(bad)} values are NaN or beyond {LARGEST:g}, the first is sample {bad[0]}"
        )
    return values


def _load_csv(path: Path, column: int | str) -> NDArray[np.float64]:
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = csv.reader(file)
        names = [name.strip() for name in next(rows, [])]
        if not names:
            raise SourceError(f"{path}: is empty, or its first line is")
        if isinstance(column, str) and column not in names:
            raise SourceError(f"{path}: no column {column!r}; it has {', '.join(names)[:200]}")
        position = names.index(column) if isinstance(column, str) else column
        if position >= len(names):
            raise SourceError(f"{path}: no column {column}; it has {len(names)}")
        has_header = isinstance(column, str) or not _is_number(names[position])
        values = [] if has_header else [float(names[position])]
        for row in rows:
            if row:
                values.append(_number(row, position, f"{path}: line {rows.line_num}"))
    return np.array(values, dtype=np.float64)


def _number(row: list[str], position: int, where: str) -> float:
    """A row's number; `where` opens the error's line. Raises SourceError."""
    if position >= len(row):
        raise SourceError(f"{where}: no column {position}; it has {len(row)}")
    if not _is_number(row[position]):
        raise SourceError(f"{where}: {row[position][:40]!r} is not a number")
    return float(row[position])


def _load_numpy(path: Path, column: int | str) -> NDArray[np.float64]:
    """A column of an .npy, or one of an .npz's arrays; what it is its bytes tell."""
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
            return _column_of(np.asarray(loaded[str(column)]), 0, path)


def _column_of(array: NDArray[Any], column: int | str, path: Path) -> NDArray[np.float64]:
    if array.ndim not in (1, 2) or array.dtype.kind not in "iuf":
        raise SourceError(
            f"{path}: needs real numbers in one or two dimensions,"
            f" has {array.dtype} in {array.ndim}"
        )
    table = array[:, np.newaxis] if array.ndim == 1 else array
    if not isinstance(column, int) or column >= table.shape[1]:
        raise SourceError(f"{path}: no column {column!r}; it has {table.shape[1]}")
    # Some NaN are signals, at which NumPy would warn; they are counted with the others.
    with np.errstate(invalid="ignore"):
        return np.ascontiguousarray(table[:, column], dtype=np.float64)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
