"""XDF files, as LabRecorder writes them of streams of LSL (https://github.com/sccn/xdf/wiki)."""

import io
import logging
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pyxdf

from protocol.errors import SourceError
from pulse_sensors.text_lines import unit_symbol
from sensing_node.files.bounds import read_whole
from sensing_node.files.grids import evenly, unsteady
from sensing_node.files.signals import ColumnKey, Floats, SignalFile, SignalInfo

MAGIC = b"XDF:"
STREAM_HEADER, SAMPLES = 2, 3
_CHANNELS = re.compile(rb"<channel_count>\s*(\d{1,9})\s*<")


def read(path: Path) -> SignalFile:
    """Open a file by pyxdf, which removes jitter and corrects clocks.

    Raises SourceError, and other errors for a damaged file.
    """
    data = read_whole(path)
    if data[:4] != MAGIC:
        raise SourceError(f"{path}: is no XDF file")
    _check_counts(data, path)
    # Its lines are for its developers; what is wrong with a file is found here.
    logging.getLogger("pyxdf").setLevel(logging.CRITICAL)
    streams, _ = pyxdf.load_xdf(io.BytesIO(data))
    starts = [float(each["time_stamps"][0]) for each in streams if len(each["time_stamps"])]
    begin_s = min(starts, default=0.0)
    signals, samples = list[SignalInfo](), list[Floats]()
    notes, left_out = list[str](), dict[ColumnKey, str]()
    for stream in streams:
        name, times_s = _text(stream["info"], "name"), np.asarray(stream["time_stamps"], float)
        if stream.get("footer") is None:
            notes.append(f"stream {name!r} has no end: the file breaks off")
        if not len(times_s):
            notes.append(f"stream {name!r} holds no sample")
            continue
        series = stream["time_series"]
        if not isinstance(series, np.ndarray):
            # Texts, such as markers.
            continue
        stated_hz = float(_text(stream["info"], "nominal_srate") or 0)
        for (label, unit), values in zip(_labels(stream, name), series.T, strict=True):
            try:
                rate_hz, even = evenly(times_s, values.astype(np.float64), path, stated_hz or None)
            except SourceError as error:
                left_out[label] = unsteady(error, path)
                continue
            info = SignalInfo(len(signals), label, unit, rate_hz, len(even), times_s[0] - begin_s)
            signals.append(info)
            samples.append(even)
    return SignalFile(path, tuple(signals), samples.__getitem__, tuple(notes), left_out)


def _check_counts(data: bytes, path: Path) -> None:
    """Refuse a chunk with more samples than bytes, for which pyxdf would allocate memory.

    Raises SourceError.
    """
    at, channels = len(MAGIC), dict[bytes, int]()
    while at < len(data):
        length, begin = _count(data, at)
        at = begin + length
        tag, stream, content = data[begin : begin + 2], data[begin + 2 : begin + 6], begin + 6
        if tag == struct.pack("<H", STREAM_HEADER):
            found = _CHANNELS.search(data, content, at)
            channels[stream] = int(found[1]) if found else 1
        elif tag == struct.pack("<H", SAMPLES):
            count, _ = _count(data, content)
            if count * max(1, channels.get(stream, 1)) > length:
                raise SourceError(
                    f"{path}: a chunk of {length} bytes at byte {begin} states {count} samples"
                )


def _count(data: bytes, at: int) -> tuple[int, int]:
    """Return a count of variable length, and the place after it."""
    width = data[at] if at < len(data) else 0
    return int.from_bytes(data[at + 1 : at + 1 + width], "little"), at + 1 + width


def _labels(stream: dict[str, Any], name: str) -> list[tuple[str, str]]:
    """Return name and unit of each channel."""
    count = len(stream["time_series"].T)
    try:
        described = stream["info"]["desc"][0]["channels"][0]["channel"]
        labels = [(_text(each, "label"), _text(each, "unit")) for each in described]
    except (KeyError, IndexError, TypeError):
        labels = []
    if len(labels) != count:
        labels = [("", "")] * count
    return [
        (label or (name if count == 1 else f"{name} {number}"), unit_symbol(unit))
        for number, (label, unit) in enumerate(labels)
    ]


def _text(table: Any, key: str) -> str:
    """Return a text of pyxdf's tables, whose values are lists."""
    found = table.get(key) if isinstance(table, dict) else None
    return str(found[0]) if isinstance(found, list) and found and found[0] is not None else ""
