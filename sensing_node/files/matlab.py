"""MATLAB files up to version 7, by scipy: arrays of numbers, also in structs.

A number named fs, or otherwise as a rate, is the rate. Files of version 7.3 are HDF5.
"""

import re
import struct
import zlib
from collections.abc import Iterator
from os import SEEK_CUR
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat, whosmat

from protocol.errors import SourceError
from sensing_node.files.bounds import check_bytes, check_samples
from sensing_node.files.columns import column_file
from sensing_node.files.signals import SignalFile

HEADER_BYTES, COMPRESSED, HDF5 = 128, 15, b"MATLAB 7.3"
_RATE = re.compile(r"f_?s|s(ample|ampling)?_?rate(_hz)?|rate(_hz)?|s?freq(uency)?", re.IGNORECASE)
# Arrays of a column each; more are those of an image.
MOST_COLUMNS, DEEPEST = 64, 4
PACKED_AT_ONCE, UNPACKED_AT_ONCE = 1 << 16, 1 << 20


def read(path: Path) -> SignalFile:
    """Open a file. Raises SourceError, and errors of scipy for a damaged one."""
    with path.open("rb") as file:
        if file.read(len(HDF5)) == HDF5:
            raise SourceError(
                f"{path}: is a MATLAB file of version 7.3 (HDF5); save it by"
                " save('NAME.mat', 'VARIABLE', '-v7'), or read it by the Python package h5py and"
                " save it by numpy.savez"
            )
    _check_unpacked(path)
    for _, shape, _ in whosmat(path):
        check_samples(path, int(np.prod(shape, dtype=object)))
    content = loadmat(path, simplify_cells=True)
    columns, rate_hz = dict[str, NDArray[Any]](), None
    for name, value in _flat({k: v for k, v in content.items() if k[:2] != "__"}, "", DEEPEST):
        last = name.rpartition(".")[2]
        if np.size(value) == 1:
            if rate_hz is None and _RATE.fullmatch(last):
                rate_hz = float(np.reshape(value, -1)[0])
        elif value.ndim == 1 or 1 in value.shape:
            columns[name if last in columns else last] = value.reshape(-1)
        elif value.ndim == 2 and min(value.shape) <= MOST_COLUMNS:
            table = value if value.shape[0] > value.shape[1] else value.T
            columns |= {f"{last}[{number}]": each for number, each in enumerate(table.T)}
    arrays = list(columns.values())
    lengths = {number: len(array) for number, array in enumerate(arrays)}
    return column_file(path, list(columns), lengths, arrays.__getitem__, rate_hz=rate_hz)


def _check_unpacked(path: Path) -> None:
    """Refuse a file of version 5 whose parts unpack to more than is read. Raises SourceError."""
    check_bytes(path, path.stat().st_size)
    size = 0
    with path.open("rb") as file:
        order = {b"IM": "<II", b"MI": ">II"}.get(file.read(HEADER_BYTES)[-2:])
        while order is not None and len(tag := file.read(8)) == 8:
            kind, left = struct.unpack(order, tag)
            if kind != COMPRESSED:
                file.seek(left, SEEK_CUR)
                continue
            unpacker = zlib.decompressobj()
            while left and (packed := file.read(min(left, PACKED_AT_ONCE))):
                left -= len(packed)
                while packed:
                    size += len(unpacker.decompress(packed, UNPACKED_AT_ONCE))
                    packed = unpacker.unconsumed_tail
                check_bytes(path, size, "unpacks to")


def _flat(value: Any, name: str, depth: int) -> Iterator[tuple[str, Any]]:
    """Yield the real numbers in a table and in tables of it, by their paths."""
    if isinstance(value, dict) and depth:
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}" if name else str(key), depth - 1)
    elif np.asarray(value).dtype.kind in "iuf":
        yield name, np.asarray(value)
