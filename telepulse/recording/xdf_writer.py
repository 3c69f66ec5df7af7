"""Export of signals as XDF (https://github.com/sccn/xdf/wiki), which pyxdf reads and none writes.

Each signal is a stream, and annotations are a stream of texts, without their lengths.
"""

import struct
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from protocol.config.quantities import count_text
from telepulse.recording.signal_table import SignalTable

MAGIC = b"XDF:"
FILE_HEADER, STREAM_HEADER, SAMPLES, CLOCK_OFFSET, STREAM_FOOTER = 1, 2, 3, 4, 6
SAMPLES_A_CHUNK = 10_000


def write(path: Path, table: SignalTable) -> list[str]:
    """Write a file; see `SignalWriter`."""
    origin_s, rate_hz, length = table.begin_ns * 1e-9, float(table.rate_hz), len(table.values)
    texts = "".join(
        f"<text><key>{escape(key)}</key><value>{escape(text)}</value></text>"
        for key, text in table.about.items()
    )
    with path.open("xb") as file:
        head = f"<info><version>1.0</version><datetime>{table.begin}</datetime></info>"
        file.write(MAGIC + _chunk(FILE_HEADER, head.encode()))
        for number, (name, unit) in enumerate(zip(table.names, table.units, strict=True), 1):
            channel = f"<channel><label>{escape(name)}</label><unit>{escape(unit)}</unit></channel>"
            described = f"<channels>{channel}</channels>" + (texts and f"<texts>{texts}</texts>")
            file.write(_header(number, name, "pulse", rate_hz, "double64", described))
            for first in range(0, length, SAMPLES_A_CHUNK):
                part = table.values[first : first + SAMPLES_A_CHUNK, number - 1]
                rows = np.empty(len(part), np.dtype([("n", "u1"), ("t", "<f8"), ("v", "<f8")]))
                rows["n"], rows["v"] = 8, part
                rows["t"] = origin_s + (first + np.arange(len(part))) / rate_hz
                file.write(_samples(number, len(part), rows.tobytes()))
            file.write(_end(number, origin_s, origin_s + (length - 1) / rate_hz, length))
        marks = sorted(table.annotations, key=lambda mark: mark.at_s)
        if marks:
            number = len(table.names) + 1
            file.write(_header(number, "marks", "Markers", 0, "string", ""))
            for mark in marks:
                text = mark.text.encode()
                row = struct.pack("<Bd", 8, origin_s + mark.at_s) + _length(len(text)) + text
                file.write(_samples(number, 1, row))
            first_s, last_s = origin_s + marks[0].at_s, origin_s + marks[-1].at_s
            file.write(_end(number, first_s, last_s, len(marks)))
    without = sum(mark.length_s is not None for mark in marks)
    count = count_text(without, "annotation is", "annotations are")
    return [f"{count} without length"] if without else []


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
