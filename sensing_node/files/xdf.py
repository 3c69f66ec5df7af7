"""XDF files, as LabRecorder writes them of streams of LSL (https://github.com/sccn/xdf/wiki)."""

import io
import re
import struct
from datetime import datetime
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
import pyxdf

from protocol.errors import SourceError
from sensing_node.files.bounds import read_whole
from sensing_node.files.grids import evenly, unsteady
from sensing_node.files.signals import (
    ColumnKey,
    FileMark,
    Floats,
    SignalFile,
    SignalInfo,
    SignalTable,
    signal_file,
    unix_ns,
    utc,
)

MAGIC = b"XDF:"
FILE_HEADER, STREAM_HEADER, SAMPLES, CLOCK_OFFSET, STREAM_FOOTER = 1, 2, 3, 4, 6
SAMPLES_A_CHUNK = 10_000
_CHANNELS = re.compile(rb"<channel_count>\s*(\d{1,9})\s*<")


def read(path: Path) -> SignalFile:
    """Open a file by pyxdf, which removes jitter and corrects clocks.

    Raises SourceError, and other errors for a damaged file.
    """
    data = read_whole(path)
    if data[:4] != MAGIC:
        raise SourceError(f"{path}: is no XDF file")
    _check_counts(data, path)
    streams, head = pyxdf.load_xdf(io.BytesIO(data))
    starts = [float(each["time_stamps"][0]) for each in streams if len(each["time_stamps"])]
    begin_s = min(starts, default=0.0)
    signals, samples = list[SignalInfo](), list[Floats]()
    notes, marks = list[str](), list[FileMark]()
    left_out, texts = dict[ColumnKey, str](), dict[str, str]()
    for stream in streams:
        name, times_s = _text(stream["info"], "name"), np.asarray(stream["time_stamps"], float)
        if stream.get("footer") is None:
            notes.append(f"stream {name!r} has no end: the file breaks off")
        if not len(times_s):
            notes.append(f"stream {name!r} holds no sample")
            continue
        texts |= _texts(stream)
        series = stream["time_series"]
        if not isinstance(series, np.ndarray):
            found = zip(times_s.tolist(), series, strict=False)
            marks += [FileMark(at_s - begin_s, " ".join(map(str, row))) for at_s, row in found]
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
    marks.sort()
    return signal_file(
        path,
        signals,
        lambda each: samples[each.number],
        _begin_ns(head),
        notes,
        marks,
        texts,
        left_out,
    )


def _begin_ns(head: Any) -> int | None:
    """Return the Unix time that the file's header states, as LabRecorder writes it; or None."""
    try:
        return unix_ns(datetime.fromisoformat(_text(head["info"], "datetime")))
    except (KeyError, TypeError, ValueError, OverflowError):
        return None


def _texts(stream: dict[str, Any]) -> dict[str, str]:
    """Return the texts that telepulse wrote into a stream's description."""
    try:
        texts = stream["info"]["desc"][0]["texts"][0]["text"]
    except (KeyError, IndexError, TypeError):
        return {}
    return {_text(each, "key"): _text(each, "value") for each in texts}


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
    units = {"microvolts": "uV", "millivolts": "mV", "volts": "V"}
    return [
        (label or (name if count == 1 else f"{name} {number}"), units.get(unit, unit))
        for number, (label, unit) in enumerate(labels)
    ]


def _text(table: Any, key: str) -> str:
    """Return a text of pyxdf's tables, whose values are lists."""
    found = table.get(key) if isinstance(table, dict) else None
    return str(found[0]) if isinstance(found, list) and found and found[0] is not None else ""


def write(path: Path, table: SignalTable) -> list[str]:
    """Write a stream for each signal, and one of texts for the marks."""
    origin_s = 0.0 if table.begin_ns is None else table.begin_ns * 1e-9
    began = ""
    if table.begin_ns is not None:
        # Of the first time in the file, from which a reader counts.
        first_s = min([0.0, *(mark.at_s for mark in table.marks)])
        began = f"<datetime>{utc(table.begin_ns + round(first_s * 1e9))}</datetime>"
    texts = "".join(
        f"<text><key>{escape(key)}</key><value>{escape(text)}</value></text>"
        for key, text in table.metadata.items()
    )
    with path.open("xb") as file:
        head = f"<info><version>1.0</version>{began}</info>"
        file.write(MAGIC + _chunk(FILE_HEADER, head.encode()))
        number = 0
        for signal, values in zip(table.signals, table.values, strict=True):
            number += 1
            rate_hz, begin_s = signal.rate_hz or table.rate_hz, origin_s + signal.begin_s
            channel = f"<channel><label>{escape(signal.name)}</label>"
            channel += f"<unit>{escape(signal.unit)}</unit></channel>"
            described = f"<channels>{channel}</channels>" + (texts and f"<texts>{texts}</texts>")
            file.write(_header(number, signal.name, "pulse", rate_hz, "double64", described))
            for first in range(0, len(values), SAMPLES_A_CHUNK):
                part = values[first : first + SAMPLES_A_CHUNK]
                times_s = begin_s + (first + np.arange(len(part))) / rate_hz
                rows = np.empty(len(part), np.dtype([("n", "u1"), ("t", "<f8"), ("v", "<f8")]))
                rows["n"], rows["t"], rows["v"] = 8, times_s, part
                file.write(_samples(number, len(part), rows.tobytes()))
            end_s = begin_s + (len(values) - 1) / rate_hz
            file.write(_end(number, begin_s, end_s, len(values)))
        if table.marks:
            number += 1
            file.write(_header(number, "marks", "Markers", 0, "string", ""))
            marked_s = sorted(origin_s + mark.at_s for mark in table.marks)
            for mark in sorted(table.marks, key=lambda each: each.at_s):
                text = mark.text.encode()
                row = struct.pack("<Bd", 8, origin_s + mark.at_s) + _length(len(text)) + text
                file.write(_samples(number, 1, row))
            file.write(_end(number, marked_s[0], marked_s[-1], len(marked_s)))
    return []


def _length(count: int) -> bytes:
    return struct.pack("<BI", 4, count)


def _chunk(tag: int, content: bytes) -> bytes:
    return _length(len(content) + 2) + struct.pack("<H", tag) + content


def _header(
    number: int, name: str, kind: str, rate_hz: float, values: str, described: str
) -> bytes:
    text = (
        f"<info><name>{escape(name)}</name><type>{kind}</type><channel_count>1</channel_count>"
        f"<nominal_srate>{rate_hz!r}</nominal_srate><channel_format>{values}</channel_format>"
        f"<desc>{described}</desc></info>"
    )
    return _chunk(STREAM_HEADER, struct.pack("<I", number) + text.encode())


def _samples(number: int, count: int, rows: bytes) -> bytes:
    return _chunk(SAMPLES, struct.pack("<I", number) + _length(count) + rows)


def _end(number: int, first_s: float, last_s: float, count: int) -> bytes:
    """Return the last chunks of a stream: offsets of its clock, and its footer."""
    # One clock: readers that correct clocks expect its offset, at two times, in each stream.
    offsets = b"".join(
        _chunk(CLOCK_OFFSET, struct.pack("<Idd", number, at_s, 0.0))
        for at_s in (first_s, max(last_s, first_s + 1))
    )
    text = (
        f"<info><first_timestamp>{first_s!r}</first_timestamp><last_timestamp>{last_s!r}"
        f"</last_timestamp><sample_count>{count}</sample_count></info>"
    )
    return offsets + _chunk(STREAM_FOOTER, struct.pack("<I", number) + text.encode())
