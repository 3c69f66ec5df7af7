"""NumPy files: the columns of an array in an .npy, or the arrays of an .npz.

An array `rate_hz` of one value in an .npz is the rate.
"""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.errors import SourceError
from sensing_node.files.columns import TIMES, named_columns, titles_of
from sensing_node.files.signals import SignalFile, SignalInfo, SignalTable, split_unit

RATE = "rate_hz"
# First bytes of an array, and of an archive of some and of none.
ARRAY, ARCHIVES = b"\x93NUMPY", (b"PK\3\4", b"PK\5\6")


def read(path: Path) -> SignalFile:
    """Open an .npy or .npz file; its first bytes decide which. Raises SourceError, and others."""
    with path.open("rb") as file:
        magic = file.read(len(ARRAY))
    rate_hz, titles, notes = None, list[str](), list[str]()
    if magic == ARRAY:
        table = _load(path)
        if table.ndim not in (1, 2) or table.dtype.kind not in "iuf":
            raise SourceError(
                f"{path}: needs real numbers in one or two dimensions,"
                f" has {table.dtype} in {table.ndim}"
            )
        arrays = dict(enumerate(table.T if table.ndim == 2 else [table]))
        titles = [""] * len(arrays)
    elif magic.startswith(ARCHIVES):
        loaded = _load_archive(path, notes)
        stated = loaded.get(RATE)
        if stated is not None and stated.size == 1:
            rate_hz = float(stated.reshape(-1)[0])
        titles = list(loaded)
        columns = {number: _column(loaded[name]) for number, name in enumerate(loaded)}
        arrays = {n: each for n, each in columns.items() if each is not None and titles[n] != RATE}
    else:
        raise SourceError(f"{path}: is no NumPy file; save it by numpy.save or numpy.savez")
    signals = tuple(
        SignalInfo(number, *split_unit(titles[number]), rate_hz, len(array))
        for number, array in arrays.items()
    )
    return SignalFile(
        path, signals, lambda keys: named_columns(path, titles, arrays, keys), notes=tuple(notes)
    )


def _column(array: NDArray[Any]) -> NDArray[Any] | None:
    """Return an array of numbers in one dimension, or the first column of one in two; else None."""
    if array.dtype.kind not in "iuf" or array.ndim not in (1, 2):
        return None
    return array if array.ndim == 1 else array[:, 0] if array.shape[1] else None


def _load(path: Path, name: str | None = None) -> NDArray[Any]:
    """Return the array in a file, or one of an archive. Raises SourceError for objects."""
    try:
        loaded = np.load(path, allow_pickle=False)
        if name is None:
            return np.asarray(loaded)
        with loaded:
            return np.asarray(loaded[name])
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise
        raise SourceError(
            f"{path}: holds Python objects in place of numbers; save an array of numbers"
        ) from None


def _load_archive(path: Path, notes: list[str]) -> dict[str, NDArray[Any]]:
    """Return the arrays of an archive; note those that cannot be loaded."""
    with zipfile.ZipFile(path) as archive:
        names = [name.removesuffix(".npy") for name in archive.namelist()]
    arrays = {}
    for name in names:
        try:
            arrays[name] = _load(path, name)
        except SourceError:
            arrays[name] = np.empty(0, object)
            notes.append(f"the array {name!r} holds Python objects, and is left out")
    return arrays


def write(path: Path, table: SignalTable) -> list[str]:
    """Write an .npz file, with an array of times in s."""
    notes: list[str] = []
    grid = table.at_one_rate(notes)
    times_s = np.arange(len(grid)) / table.rate_hz
    columns = dict(zip(titles_of(table), grid.T, strict=True))
    np.savez(path, **{TIMES: times_s, RATE: np.float64(table.rate_hz)} | columns)
    return notes
