"""EDF, EDF+ and BDF files, by edfio (Kemp et al. 1992 and 2003, https://www.edfplus.info).

edfio joins the records of a discontinuous file (EDF+D) as if they followed one another; here, each
is moved to its onset. In a file that telepulse wrote, the lowest code is a missing sample.
"""

import re
import warnings
from pathlib import Path
from typing import Any

import edfio
import numpy as np

from protocol.errors import SourceError
from sensing_node.files.bounds import check_bytes, check_samples, read_whole
from sensing_node.files.grids import on_grid
from sensing_node.files.signals import ColumnKey, Floats, SignalFile, SignalInfo

VERSIONS, WRITER = (b"0", b"\xffBIOSEMI"), "telepulse"
# Bytes of the header, and again of each signal; fields of it.
HEADER_BYTES = 256
LENGTH, RESERVED = slice(184, 192), slice(192, 236)
RECORDS, COUNT = slice(236, 244), slice(252, 256)
# Place of the samples in a record among the fields of the signals, and widths.
PER_RECORD, LABEL, NUMBER = 216, 16, 8
MOST_SIGNALS = 1000
ANNOTATIONS = " Annotations"
_ONSET = re.compile(rb"([+-]\d+(?:\.\d*)?)(?:\x15\d+(?:\.\d*)?)?\x14")


def read(path: Path) -> SignalFile:
    """Open a file. Raises SourceError, and errors of edfio for a damaged one."""
    with path.open("rb") as file:
        head = file.read(HEADER_BYTES)
    if len(head) < HEADER_BYTES:
        raise SourceError(f"{path}: is shorter than the header of an EDF file")
    if head[:8].strip() not in VERSIONS:
        raise SourceError(f"{path}: is no EDF or BDF file")
    try:
        edf, stated = _opened(path, head), int(head[RECORDS])
        held = edf.num_data_records
        signals = [each for each in edf.signals if not each.label.endswith(ANNOTATIONS)]
        plain = [each for each in signals if _has_range(each)]
    except ValueError as error:
        raise SourceError(f"{path}: its header is damaged: {error}") from None
    if not held:
        raise SourceError(f"{path}: holds no whole data record")
    records = min(held, stated) if stated > 0 else held
    check_samples(path, records * max((s.samples_per_data_record for s in signals), default=0))
    left_out: dict[ColumnKey, str] = {
        s.label: f"has the range {tuple(s.physical_range)} for the codes {tuple(s.digital_range)}"
        for s in signals
        if s not in plain
    }
    discontinuous = head[RESERVED].strip()[3:5] == b"+D"
    onsets_s = _onsets_s(path, head, records, edf.data_record_duration) if discontinuous else None
    ours = WRITER in edf.local_recording_identification.split()

    def values(number: int) -> Floats:
        signal, samples = plain[number], infos[number].samples
        scaled: Floats = signal.data[:samples]
        if ours:
            codes = signal.digital[:samples]
            scaled = np.where(codes == signal.digital_min, np.nan, scaled)
        if onsets_s is None:
            return scaled
        within_s = np.arange(signal.samples_per_data_record) / signal.sampling_frequency
        t_s = (onsets_s[:, np.newaxis] + within_s).ravel()
        return on_grid(t_s, scaled, signal.sampling_frequency, path)

    infos = [
        SignalInfo(
            number,
            each.label,
            "" if each.physical_dimension == "-" else each.physical_dimension,
            each.sampling_frequency,
            records * each.samples_per_data_record,
        )
        for number, each in enumerate(plain)
    ]
    states = f"the header states {stated} records, and the file holds {held}"
    return SignalFile(path, tuple(infos), values, (states,) if stated > held else (), left_out)


def _has_range(signal: Any) -> bool:
    """Return whether a signal's codes stand for values: real recorders have others, too."""
    (low, high), (least, most) = signal.physical_range, signal.digital_range
    return bool(low != high and least < most and np.isfinite([low, high]).all())


def _opened(path: Path, head: bytes) -> Any:
    """Return a file as edfio opens it. Raises SourceError or ValueError."""
    count = int(head[COUNT])
    if not 1 <= count <= MOST_SIGNALS:
        raise ValueError(f"{count} signals")
    length = b"%d" % (HEADER_BYTES * (1 + count))
    wide = head[:1] == VERSIONS[1][:1]
    # Of an EDF, samples are read as they are loaded.
    file: Path | bytes = path
    if wide:
        check_bytes(path, path.stat().st_size)
    if head[LENGTH].strip() != length:
        whole = read_whole(path)
        file = whole[: LENGTH.start] + length.ljust(NUMBER) + whole[LENGTH.stop :]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return (edfio.read_bdf if wide else edfio.read_edf)(file, header_encoding="latin-1")


def _onsets_s(path: Path, head: bytes, records: int, record_s: float) -> Floats:
    """Return the onset of each record in s after the first one, by its first annotation."""
    count = int(head[COUNT])
    data = np.memmap(path, np.uint8, "r", HEADER_BYTES)
    fields = data[: HEADER_BYTES * count].tobytes()
    labels = [fields[n * LABEL : (n + 1) * LABEL].strip() for n in range(count)]
    counts = fields[PER_RECORD * count : (PER_RECORD + NUMBER) * count]
    size = 3 if head[:1] == VERSIONS[1][:1] else 2
    widths = [size * int(counts[n * NUMBER : (n + 1) * NUMBER]) for n in range(count)]
    rows = data[HEADER_BYTES * count :][: records * sum(widths)].reshape(records, sum(widths))
    onsets_s: Floats = np.arange(records, dtype=np.float64) * record_s
    notes = next((n for n in range(count) if labels[n].endswith(ANNOTATIONS.encode())), count)
    begin = sum(widths[:notes])
    for record, row in enumerate(rows[:, begin : begin + sum(widths[notes : notes + 1])]):
        if (found := _ONSET.match(row.tobytes())) is not None:
            onsets_s[record] = float(found[1])
    onsets_s -= onsets_s[0]
    return onsets_s
