"""Files that harm: each ends in one line, before memory is allocated for what it states."""

import io
import os
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow
import pytest
import scipy.io
from mcap.writer import CompressionType, Writer
from numpy.lib import format as npy
from pyarrow import parquet

from protocol.errors import SourceError
from sensing_node.files import bounds, mcap_messages
from sensing_node.files.formats import FORMATS
from sensing_node.files.signal_choice import record_table
from tests.support.refusals import refusal_of
from tests.support.signal_files import wfdb_record

SUFFIXES = [suffix for known in FORMATS for suffix in known.suffixes]
MANY = 300_000_000


def refusal(path: Path) -> str:
    """Return the line that refuses a file, without its name."""
    return refusal_of(SourceError, record_table, path).removeprefix(f"{path}: ")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_is_no_regular_file_is_refused_at_once(tmp_path: Path, suffix: str) -> None:
    zeros, pipe = tmp_path / f"zeros{suffix}", tmp_path / f"pipe{suffix}"
    zeros.symlink_to("/dev/zero")
    os.mkfifo(pipe)
    advice = "copy what it gives into a regular file"
    assert refusal(zeros) == f"cannot be read: it is a character device; {advice}"
    assert refusal(pipe) == f"cannot be read: it is a named pipe; {advice}"
    assert refusal(Path("/dev/zero")) == f"cannot be read: it is a character device; {advice}"


def test_a_named_pipe_in_a_record_is_refused_at_once(tmp_path: Path) -> None:
    record = wfdb_record(tmp_path, {"ABP": np.arange(100.0)})
    record.with_suffix(".dat").unlink()
    os.mkfifo(record.with_suffix(".dat"))
    with pytest.raises(SourceError, match=r"rec\.dat: cannot be read: it is a named pipe"):
        record_table(record)


def _array_header(kind: str) -> bytes:
    head = io.BytesIO()
    table = {"descr": kind, "fortran_order": False, "shape": (MANY,)}
    npy.write_array_header_1_0(head, table)
    return head.getvalue()


def _npy(path: Path) -> None:
    path.write_bytes(_array_header("<f8") + bytes(100))


def _npz(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("x.npy", _array_header("|i1"))


def _parquet(path: Path) -> None:
    none = pyarrow.nulls(MANY // 100, pyarrow.int8())
    table = pyarrow.table({"x": pyarrow.chunked_array([none] * 100)})
    parquet.write_table(table, path, use_dictionary=False, row_group_size=MANY)


def _edf(path: Path) -> None:
    head = b"0".ljust(168) + b"01.01.2401.01.01512".ljust(68) + b"9999999 1       1   "
    widths = ((b"ABP", 16), (b"", 80), (b"mmHg", 8), (b"0", 8), (b"200", 8), (b"-32768", 8),
              (b"32767", 8), (b"", 80), (b"100", 8), (b"", 32))  # fmt: skip
    with path.open("wb") as file:
        file.write(head + b"".join(text.ljust(width) for text, width in widths))
        # A sparse file.
        file.truncate(512 + 9_999_999 * 200)


def _hea(path: Path) -> None:
    wfdb_record(path.parent, {"ABP": np.arange(100.0)}, name="part")
    lines = f"{path.stem}/3 1 250 {MANY + 200}\npart 100\n~ {MANY}\npart 100\n"
    path.write_text(lines, encoding="utf-8")


def _mat(path: Path) -> None:
    scipy.io.savemat(path, {"x": np.arange(8.0)})
    data = path.read_bytes()
    shape = struct.pack("<ii", 1, 8)
    assert shape in data[136:]
    path.write_bytes(data[:136] + data[136:].replace(shape, struct.pack("<ii", 1, MANY), 1))


@pytest.mark.parametrize("make", [_npy, _npz, _parquet, _edf, _hea, _mat])
def test_a_file_that_states_too_many_samples_is_refused(
    tmp_path: Path, make: Callable[[Path], None]
) -> None:
    path = tmp_path / f"a.{make.__name__[1:]}"
    make(path)
    line = refusal(path)
    assert line.startswith("states ")
    assert line.endswith("; at most 172800000 are read (48 h at 1000 Hz): cut it into parts")


@pytest.mark.parametrize("suffix", [".wav", ".xdf", ".hea", ".mat"])
def test_a_file_that_is_read_as_a_whole_has_a_bound(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    with path.open("wb") as file:
        file.truncate(20_000_000_000)
    assert refusal(path).startswith("has 20 GB; at most 1.38 GB are read (48 h at 1000 Hz)")


def test_what_unpacks_to_too_much_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    archive = tmp_path / "a.npz"
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("x.npy", _array_header("|i1"))
        file.getinfo("x.npy").file_size = 2_000_000_000
    assert refusal(archive).startswith("unpacks to 2 GB; at most 1.38 GB are read")
    monkeypatch.setattr(bounds, "MOST_BYTES", 2_000_000)
    data = zlib.compress(bytes(8_000_000))
    head = b"MATLAB 5.0 MAT-file".ljust(126) + b"IM" + struct.pack("<II", 15, len(data))
    (tmp_path / "a.mat").write_bytes(head + data)
    assert refusal(tmp_path / "a.mat").startswith("unpacks to 0.008 GB; at most 0.002 GB")
    monkeypatch.setattr(mcap_messages, "MAX_RECORD_BYTES", 100_000)
    for kind in (CompressionType.ZSTD, CompressionType.LZ4):
        path = tmp_path / f"{kind.name}.mcap"
        with path.open("wb") as out:
            writer = Writer(out, compression=kind)
            writer.start()
            channel = writer.register_channel("force", "json", 0)
            writer.add_message(channel, 0, b"[" + b" " * 200_000 + b"]", 0)
            writer.finish()
        assert refusal(path).endswith("unpacks to 200067; at most 100000 are read")
    monkeypatch.undo()
    assert refusal(path).endswith("unpack to more than 32 times as many, which no recording does")


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
@pytest.mark.parametrize(
    ("version", "words"),
    [
        (b"\0\1", "is of version 0.1 of the format, which is unknown"),
        (b"\2\0", "its header is damaged: it states 4000000000 bytes"),
    ],
)
def test_a_header_of_an_array_is_read_by_no_more_than_its_length(
    tmp_path: Path, suffix: str, version: bytes, words: str
) -> None:
    path = tmp_path / f"a{suffix}"
    array = b"\x93NUMPY" + version + struct.pack("<I", 4_000_000_000) + b"{'descr': '<f4'"
    if suffix == ".npz":
        with zipfile.ZipFile(path, "w") as file:
            file.writestr("x.npy", array)
    else:
        path.write_bytes(array)
    tracemalloc.start()
    try:
        assert refusal(path) == f"cannot be read: {words}"
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


def test_what_a_library_does_not_expect_is_told_in_words_for_people(tmp_path: Path) -> None:
    path, other = tmp_path / "a.xdf", tmp_path / "a.wav"
    path.write_bytes(b"XDF:\x04" + struct.pack("<IHI", 2_000_000_000, 4, 1) + b"<info></info>")
    assert refusal(path) == "is damaged, or is no XDF file"
    other.write_bytes(b"RIFF\xff\xff\0\0WAVEjunk\xff\xff\0\0" + bytes(100))
    assert refusal(other) == "is damaged, or is no WAV file"
