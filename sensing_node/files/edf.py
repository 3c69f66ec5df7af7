"""EDF, EDF+ and BDF files (Kemp et al. 1992 and 2003, https://www.edfplus.info; BioSemi's BDF).

A discontinuous file (EDF+D) gets its gaps back from the onset of each record. Files are written by
edfio, with the lowest code as a missing value; read here, since edfio leaves out an EDF+D's gaps.
"""

import math
import re
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.errors import SourceError
from sensing_node.files.bounds import check_samples
from sensing_node.files.edf_texts import WRITER, ascii_text, identifications, read_texts
from sensing_node.files.grids import on_grid
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

# Limit of values, so that each fits the 8 characters of the header.
LARGEST = 1e7
HEADER_BYTES = 256
# Widths of a signal's header fields.
LABEL, TRANSDUCER, UNIT, NUMBER, FILTERS, RESERVED = 16, 80, 8, 8, 80, 32
MOST_SIGNALS = 1000
# Margin, as a share of the range, that keeps written values above the lowest code.
RANGE_MARGIN = 0.02
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
    check_samples(path, records * max(layout.per_record))
    table = data[begin : begin + records * record_bytes].reshape(records, record_bytes)
    starts = np.cumsum([0, *layout.per_record]) * size
    annotations = [n for n, label in enumerate(layout.labels) if label.endswith(" Annotations")]
    even_s = np.arange(records, dtype=np.float64) * layout.record_s
    onsets_s, marks, begin_ns = even_s, list[FileMark](), layout.begin_ns
    if layout.plus and annotations:
        columns = [table[:, starts[n] : starts[n + 1]] for n in annotations]
        onsets_s, marks, first_s = _annotations(columns, even_s)
        # The header has whole seconds, and the first record the rest.
        begin_ns = None if begin_ns is None else begin_ns + round(first_s * 1e9)
    left_out: dict[ColumnKey, str] = {
        layout.labels[n]: f"has the range {layout.physical[n]} for the codes {layout.digital[n]}"
        for n in range(len(layout.labels))
        if n not in annotations and not _has_range(layout.physical[n], layout.digital[n])
    }
    plain = [
        n
        for n in range(len(layout.labels))
        if n not in annotations and _has_range(layout.physical[n], layout.digital[n])
    ]
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

    return signal_file(path, signals, values, begin_ns, notes, marks, layout.metadata, left_out)


def _has_range(physical: tuple[float, float], digital: tuple[int, int]) -> bool:
    """Return whether a signal's codes stand for values: real recorders have others, too."""
    differ = physical[0] != physical[1] and digital[0] < digital[1]
    return differ and bool(np.all(np.isfinite(physical)))


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
    counts = [int(each) for each in per_record]
    if min(counts) < 0:
        raise ValueError(f"a record of {min(counts)} samples")
    reserved = text[192:236].strip()
    plus = reserved[4] if reserved[:4] in ("EDF+", "BDF+") and len(reserved) > 4 else ""
    patient, recording = text[8:88].strip(), text[88:168].strip()
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
        read_texts(patient, recording),
    )
    return layout, int(text[236:244])


def _begin_ns(text: str) -> int | None:
    """Return the Unix time of the begin, taken as UTC; None for a date that is left out."""
    if text[88:168].startswith("Startdate X"):
        return None
    try:
        at = datetime.strptime(text[168:184], "%d.%m.%y%H.%M.%S")
    except ValueError:
        return None
    # Two digits of a year: 85 to 99 are those of 1985 to 1999.
    year = at.year % 100 + (1900 if at.year % 100 >= 85 else 2000)
    return unix_ns(at.replace(year=year))


def _decode(table: NDArray[np.uint8], wide: bool) -> Floats:
    """Return the codes of a signal, shape (records, samples of a record)."""
    if not wide:
        return np.ascontiguousarray(table).view("<i2").astype(np.float64)
    # In the upper bytes, so that the sign is right.
    codes = np.pad(table.reshape(len(table), -1, 3), ((0, 0), (0, 0), (1, 0)))
    return (np.ascontiguousarray(codes).view("<i4")[..., 0] >> 8).astype(np.float64)


def _annotations(
    columns: list[NDArray[np.uint8]], expected_s: Floats
) -> tuple[Floats, list[FileMark], float]:
    """Return the onset of each record in s after the first one, the annotations, and that one."""
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
                length_s = float(found[2]) if found[2] else None
                marks += [
                    FileMark(at_s, text.decode("utf-8", "replace"), length_s)
                    for text in texts
                    if text
                ]
    first_s = float(onsets_s[0])
    marks = [mark._replace(at_s=mark.at_s - first_s) for mark in marks]
    return onsets_s - first_s, marks, first_s


def write(path: Path, table: SignalTable) -> list[str]:
    """Write a file of whole seconds, at whole rates: BDF with 24 bits by its suffix, else EDF+."""
    import edfio

    wide = path.suffix.lower() == ".bdf"
    notes: list[str] = []
    rates = [signal.rate_hz or table.rate_hz for signal in table.signals]
    values, together = table.values, len({signal.begin_s for signal in table.signals}) == 1
    if not together or any(rate != round(rate) for rate in rates):
        rates = [float(round(table.rate_hz))] * len(rates)
        values = list(table.at_one_rate(notes, rates[0]).T)
    seconds = max(
        math.ceil(len(each) / rate - 1e-9) for each, rate in zip(values, rates, strict=True)
    )
    bits = 24 if wide else 16
    signals = [
        _signal(edfio, info.name, info.unit, each, round(rate), seconds, bits)
        for info, each, rate in zip(table.signals, values, rates, strict=True)
    ]
    if any(len(each) < seconds * rate for each, rate in zip(values, rates, strict=True)):
        notes.append(f"missing samples fill up whole seconds, {seconds} s")
    begin = None if table.begin_ns is None else utc(table.begin_ns)
    patient, recording = identifications(edfio, table.metadata, begin)
    marks = [edfio.EdfAnnotation(mark.at_s, mark.length_s, mark.text) for mark in table.marks]
    (edfio.Bdf if wide else edfio.Edf)(
        signals,
        patient=patient,
        recording=recording,
        starttime=None if begin is None else begin.time(),
        annotations=sorted(marks, key=lambda mark: float(mark.onset)),
    ).write(path)
    steps = ", ".join(
        f"{one.label} {(one.physical_max - one.physical_min) / ((1 << bits) - 1):.2g}"
        f" {one.physical_dimension}".rstrip()
        for one in signals
    )
    return [*notes, f"{bits} bits; quantisation steps: {steps}"]


def _signal(
    edfio: Any, name: str, unit: str, values: Floats, rate_hz: int, seconds: int, bits: int
) -> Any:
    """Return a signal of whole seconds; the lowest code marks its missing samples."""
    whole = np.full(seconds * rate_hz, np.nan)
    whole[: len(values)] = values
    low, high = _range(whole[~np.isnan(whole)])
    if max(abs(low), abs(high)) >= LARGEST:
        raise ValueError(
            f"{name} reaches {max(low, high, key=abs):.3g}; scale it below {LARGEST:g}"
        )
    return (edfio.BdfSignal if bits == 24 else edfio.EdfSignal)(
        np.where(np.isnan(whole), low, whole),
        rate_hz,
        label=ascii_text(name)[:LABEL],
        physical_dimension=ascii_text(unit)[:UNIT],
        physical_range=(low, high),
        digital_range=(-(1 << (bits - 1)), (1 << (bits - 1)) - 1),
    )


def _range(values: Floats) -> tuple[float, float]:
    """Return limits just outside the values; each fits the 8 characters of an EDF header."""
    if not len(values):
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    width = max(high - low, 1e-3, 1e-4 * abs(low), 1e-4 * abs(high))
    power = math.floor(math.log10(width))
    unit, digits = 10.0 ** (power - 1), max(0, 1 - power)
    low = math.floor((low - RANGE_MARGIN * width) / unit) * unit
    high = math.ceil((high + RANGE_MARGIN * width) / unit) * unit
    return round(low, digits), round(high, digits)
