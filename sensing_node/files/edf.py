"""EDF, EDF+ and BDF files (Kemp et al. 1992 and 2003, https://www.edfplus.info; BioSemi's BDF).

A discontinuous file (EDF+D) gets its gaps back from the onset of each record.
"""

import re
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.errors import SourceError
from sensing_node.files.signals import (
    FileMark,
    Floats,
    SignalFile,
    SignalInfo,
    on_grid,
    signal_file,
)

WRITER = "telepulse"
HEADER_BYTES = 256
# Widths of a signal's header fields.
LABEL, TRANSDUCER, UNIT, NUMBER, FILTERS, RESERVED = 16, 80, 8, 8, 80, 32
MOST_SIGNALS = 1000
_ONSET = re.compile(rb"([+-]\d+(?:\.\d*)?)(?:\x15(\d+(?:\.\d*)?))?\x14")


class EdfLayout(NamedTuple):
    """Header of a file: its signals' labels, units, ranges, and samples in a record."""

    labels: list[str]
    units: list[str]
    physical: list[tuple[float, float]]
    digital: list[tuple[int, int]]
    per_record: list[int]
    record_s: float
    begin_ns: int | None
    plus: str
    ours: bool
    metadata: dict[str, str]


def read(path: Path) -> SignalFile:
    """Open a file. Raises SourceError or OSError."""
    data = np.memmap(path, np.uint8, "r") if path.stat().st_size else np.empty(0, np.uint8)
    wide = bytes(data[:1]) == b"\xff"
    size = 3 if wide else 2
    try:
        layout, stated = _read_header(data, path)
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise SourceError(f"{path}: its header is damaged: {error}") from None
    record_bytes = size * sum(layout.per_record)
    begin = HEADER_BYTES * (1 + len(layout.labels))
    records = max(0, len(data) - begin) // record_bytes if record_bytes else 0
    if not records:
        raise SourceError(f"{path}: holds no whole data record")
    notes = []
    if stated > records:
        notes.append(f"the header states {stated} records, and the file holds {records}")
    records = min(records, stated) if stated > 0 else records
    table = data[begin : begin + records * record_bytes].reshape(records, record_bytes)
    starts = np.cumsum([0, *layout.per_record]) * size
    annotations = [n for n, label in enumerate(layout.labels) if label.endswith(" Annotations")]
    even_s = np.arange(records, dtype=np.float64) * layout.record_s
    onsets_s, marks = even_s, list[FileMark]()
    if layout.plus and annotations:
        columns = [table[:, starts[n] : starts[n + 1]] for n in annotations]
        onsets_s, marks = _annotations(columns, even_s)
    plain = [n for n in range(len(layout.labels)) if n not in annotations]
    if plain and not layout.record_s > 0:
        raise SourceError(f"{path}: its records last {layout.record_s:g} s")
    rates = [layout.per_record[n] / layout.record_s for n in plain]
    signals = [
        SignalInfo(at, layout.labels[n], layout.units[n], rate, records * layout.per_record[n])
        for at, (n, rate) in enumerate(zip(plain, rates, strict=True))
    ]

    def values(signal: SignalInfo) -> Floats:
        n, rate_hz = plain[signal.number], rates[signal.number]
        codes = _decode(table[:, starts[n] : starts[n + 1]], wide)
        (low, high), (least, most) = layout.physical[n], layout.digital[n]
        scaled = (codes - least) * ((high - low) / (most - least)) + low
        if layout.ours:
            scaled[codes == least] = np.nan
        if layout.plus != "D":
            return scaled.ravel()
        within_s: Floats = np.arange(layout.per_record[n], dtype=np.float64) / rate_hz
        t_s: Floats = (onsets_s[:, np.newaxis] + within_s).ravel()
        return on_grid(t_s, scaled.ravel(), rate_hz, path)

    return signal_file(path, signals, values, layout.begin_ns, notes, marks, layout.metadata)


def _read_header(data: NDArray[np.uint8], path: Path) -> tuple[EdfLayout, int]:
    """Return the header, and the number of records that it states. Raises ValueError."""
    if len(data) < HEADER_BYTES:
        raise SourceError(f"{path}: is shorter than the header of an EDF file")
    head = bytes(data[:HEADER_BYTES])
    if head[:8].strip() not in (b"0", b"\xffBIOSEMI"):
        raise SourceError(f"{path}: is no EDF or BDF file")
    text = head.decode("latin-1")
    count = int(text[252:256])
    if not 1 <= count <= MOST_SIGNALS:
        raise ValueError(f"{count} signals")
    block = bytes(data[HEADER_BYTES : HEADER_BYTES * (1 + count)]).decode("latin-1")
    if len(block) < HEADER_BYTES * count:
        raise ValueError(f"it breaks off within its {count} signals")
    fields, at = [], 0
    for width in (LABEL, TRANSDUCER, UNIT, *[NUMBER] * 4, FILTERS, NUMBER, RESERVED):
        fields.append([block[at + n * width : at + (n + 1) * width].strip() for n in range(count)])
        at += width * count
    labels, _, units, low, high, least, most, _, per_record, _ = fields
    physical = [(float(a), float(b)) for a, b in zip(low, high, strict=True)]
    digital = [(int(a), int(b)) for a, b in zip(least, most, strict=True)]
    for label, real, codes in zip(labels, physical, digital, strict=True):
        equal = codes[0] >= codes[1] or real[0] == real[1] or not np.all(np.isfinite(real))
        if equal and not label.endswith(" Annotations"):
            raise ValueError(f"signal {label!r} has the range {real} for {codes}")
    counts = [int(each) for each in per_record]
    if min(counts) < 0:
        raise ValueError(f"a record of {min(counts)} samples")
    reserved = text[192:236].strip()
    plus = reserved[4] if reserved[:4] in ("EDF+", "BDF+") and len(reserved) > 4 else ""
    recording = text[88:168].strip()
    metadata = {"patient": text[8:88].strip(), "recording": recording}
    layout = EdfLayout(
        labels,
        ["" if unit in ("-", "") else unit for unit in units],
        physical,
        digital,
        counts,
        float(text[244:252]),
        _begin_ns(text),
        plus,
        WRITER in recording.split(),
        {key: value for key, value in metadata.items() if value},
    )
    return layout, int(text[236:244])


def _begin_ns(text: str) -> int | None:
    """Return the Unix time of the begin; the header's time is taken as UTC."""
    try:
        at = datetime.strptime(text[168:184], "%d.%m.%y%H.%M.%S").replace(tzinfo=UTC)
    except ValueError:
        return None
    # Two digits of a year: 85 to 99 are those of 1985 to 1999.
    year = at.year % 100 + (1900 if at.year % 100 >= 85 else 2000)
    return round(at.replace(year=year).timestamp() * 1e9)


def _decode(table: NDArray[np.uint8], wide: bool) -> Floats:
    """Return the codes of a signal, shape (records, samples of a record)."""
    if not wide:
        return np.ascontiguousarray(table).view("<i2").astype(np.float64)
    # In the upper bytes, so that the sign is right.
    codes = np.pad(table.reshape(len(table), -1, 3), ((0, 0), (0, 0), (1, 0)))
    return (np.ascontiguousarray(codes).view("<i4")[..., 0] >> 8).astype(np.float64)


def _annotations(
    columns: list[NDArray[np.uint8]], expected_s: Floats
) -> tuple[Floats, list[FileMark]]:
    """Return the onset of each record in s after the first one, and the annotations."""
    onsets_s, marks = np.array(expected_s, float), list[FileMark]()
    for place, column in enumerate(columns):
        for record, row in enumerate(column):
            for number, entry in enumerate(row.tobytes().split(b"\0")):
                found = _ONSET.match(entry)
                if found is None:
                    continue
                at_s = float(found[1])
                if place == 0 and number == 0:
                    onsets_s[record] = at_s
                texts = entry[found.end() :].split(b"\x14")
                marks += [FileMark(at_s, text.decode("utf-8", "replace")) for text in texts if text]
    first_s = float(onsets_s[0])
    return onsets_s - first_s, [FileMark(mark.at_s - first_s, mark.text) for mark in marks]
