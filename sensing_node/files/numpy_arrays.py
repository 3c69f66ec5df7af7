"""NumPy files: the columns of an array in an .npy, or the arrays of an .npz.

An array `rate_hz` of one value in an .npz is the rate. A large .npy stays on the disk, from which
its samples are read as they are played.
"""

import io
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from protocol.errors import SourceError
from sensing_node.files.bounds import check_bytes, check_samples
from sensing_node.files.columns import column_file
from sensing_node.files.signals import SignalFile

RATE = "rate_hz"
# First bytes of an array, and of an archive of some and of none.
ARRAY, ARCHIVES = b"\x93NUMPY", (b"PK\3\4", b"PK\5\6")
# Bytes from which on an array stays on the disk: another program may cut a file meanwhile.
LARGE = 1 << 24
# Bytes that state the length of a header, by the version of the format; and the longest one that
# numpy reads.
LENGTH_BYTES = {(1, 0): 2, (2, 0): 4, (3, 0): 4}
MOST_HEADER_BYTES = 10_000
OBJECTS = "holds Python objects in place of numbers; save an array of numbers"


def read(path: Path) -> SignalFile:
    """Open an .npy or .npz file; its first bytes decide which. Raises SourceError, and others."""
    with path.open("rb") as file:
        magic = file.read(len(ARRAY))
    if magic == ARRAY:
        return _array_file(path)
    if magic.startswith(ARCHIVES):
        return _archive_file(path)
    raise SourceError(f"{path}: is no NumPy file; save it by numpy.save or numpy.savez")


def _array_file(path: Path) -> SignalFile:
    with path.open("rb") as file:
        shape, dtype = _header(file)
    if dtype.hasobject:
        raise SourceError(f"{path}: {OBJECTS}")
    if len(shape) not in (1, 2) or dtype.kind not in "iuf":
        raise SourceError(
            f"{path}: needs real numbers in one or two dimensions, has {dtype} in {len(shape)}"
        )
    check_samples(path, shape[0])
    # Mapping checks the size that the header states against that of the file.
    large = path.stat().st_size > LARGE
    table = np.load(path, mmap_mode="r") if 0 not in shape else np.empty(shape, dtype)
    table = table if large else np.array(table)
    columns = table.T if table.ndim == 2 else [table]
    numbers = dict.fromkeys(range(len(columns)), shape[0])
    return column_file(path, [""] * len(columns), numbers, lambda number: columns[number])


def _archive_file(path: Path) -> SignalFile:
    titles, numbers, notes, rate_hz = list[str](), dict[int, int](), list[str](), None
    with zipfile.ZipFile(path) as archive:
        check_bytes(path, sum(each.file_size for each in archive.infolist()), "unpacks to")
        for member in archive.namelist():
            name = member.removesuffix(".npy")
            with archive.open(member) as file:
                shape, dtype = _header(file)
            titles.append(name)
            if dtype.hasobject:
                notes.append(f"the array {name!r} holds Python objects, and is left out")
            elif dtype.kind not in "iuf" or len(shape) > 2 or 0 in shape[1:]:
                continue
            elif name == RATE and shape in ((), (1,), (1, 1)):
                rate_hz = float(_member(path, member).reshape(-1)[0])
            elif shape:
                check_samples(path, shape[0])
                numbers[len(titles) - 1] = shape[0]

    @lru_cache(maxsize=1)
    def column(number: int) -> NDArray[Any]:
        array = _member(path, f"{titles[number]}.npy")
        return array if array.ndim == 1 else array[:, 0]

    return column_file(path, titles, numbers, column, rate_hz=rate_hz, notes=tuple(notes))


def _header(file: Any) -> tuple[tuple[int, ...], "np.dtype[Any]"]:
    """Return shape and kind of numbers of an array. Raises ValueError."""
    version = npy.read_magic(file)
    if version not in LENGTH_BYTES:
        raise ValueError(f"is of version {version[0]}.{version[1]} of the format, which is unknown")
    width = LENGTH_BYTES[version]
    # As many bytes as this states would be allocated.
    if (length := int.from_bytes(file.read(width), "little")) > MOST_HEADER_BYTES:
        raise ValueError(f"its header is damaged: it states {length} bytes")
    file.seek(-width, io.SEEK_CUR)
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, _, dtype = read_header(file)
    return shape, dtype


def _member(path: Path, name: str) -> NDArray[Any]:
    with np.load(path, allow_pickle=False) as loaded:
        return np.asarray(loaded[name])
