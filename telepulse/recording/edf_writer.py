"""Export of signals as EDF+, by edfio, with the lowest code as a missing sample.

The header has two fields of texts, on the patient and on the recording. Each has parts of fixed
meaning, then further ones. The subject is the patient's code; each other text is a further part,
such as "side=left", in the first of the two fields with space for it.
"""

import math
import unicodedata
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from telepulse.recording.signal_table import Floats, SignalTable, plain_micro

# Of the header: characters of a label and of a unit, and a limit of values that fit in 8.
LABEL, UNIT, LARGEST = 16, 8, 1e7
BITS = 16
LOWEST, HIGHEST = -(1 << (BITS - 1)), (1 << (BITS - 1)) - 1
# Margin, as a share of the range, that keeps values above the lowest code.
RANGE_MARGIN = 0.02
WRITER, UTC_TIMES = "telepulse", "times_are_UTC"
# Text that is the patient's code, and its characters, of 80 of the field.
SUBJECT, LONGEST_CODE = "subject", 30


def write(path: Path, table: SignalTable) -> list[str]:
    """Write a file; see `SignalWriter`. Raises ImportError without edfio."""
    import edfio

    signals = [
        _signal(edfio, name, unit, values, table.rate_hz)
        for name, unit, values in zip(table.names, table.units, table.values.T, strict=True)
    ]
    patient, recording, left_out = _identifications(edfio, table.about, table.begin)
    marks = [edfio.EdfAnnotation(each.at_s, each.length_s, each.text) for each in table.annotations]
    edfio.Edf(
        signals,
        patient=patient,
        recording=recording,
        starttime=table.begin.time(),
        annotations=sorted(marks, key=lambda mark: float(mark.onset)),
    ).write(path)
    steps = (
        f"{one.label} {(one.physical_max - one.physical_min) / (HIGHEST - LOWEST):.2g}"
        f" {one.physical_dimension}"
        for one in signals
    )
    notes = [f"{BITS} bits; quantisation steps: {', '.join(steps)}"]
    cut = [
        f"{name} is written as {one.label}"
        for name, one in zip(table.names, signals, strict=True)
        if name != one.label
    ]
    notes += [f"names are changed: {', '.join(cut)}"] if cut else []
    return notes + ([f"texts are changed or left out: {', '.join(left_out)}"] if left_out else [])


def _signal(edfio: Any, name: str, unit: str, values: Floats, rate_hz: int) -> Any:
    """Return a signal; the lowest code marks its missing samples."""
    low, high = _range(values[~np.isnan(values)])
    if max(abs(low), abs(high)) >= LARGEST:
        raise ValueError(
            f"{name} reaches {max(low, high, key=abs):.3g}; scale it below {LARGEST:g}"
        )
    return edfio.EdfSignal(
        np.where(np.isnan(values), low, values),
        rate_hz,
        label=_ascii(name)[:LABEL],
        physical_dimension=_ascii(unit)[:UNIT],
        physical_range=(low, high),
        digital_range=(LOWEST, HIGHEST),
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


def _identifications(
    edfio: Any, about: Mapping[str, str], begin: datetime
) -> tuple[Any, Any, list[str]]:
    """Return the header's two fields, and the keys of texts that they do not hold whole."""
    texts = {_word(key): _word(text) for key, text in about.items() if text}
    code = texts.pop(SUBJECT, "X")
    patient = _filled(edfio.Patient, {"code": code[:LONGEST_CODE]}, [], texts)
    fixed = {"startdate": begin.date(), "equipment_code": WRITER}
    recording = _filled(edfio.Recording, fixed, [UTC_TIMES], texts)
    changed = [key for key, text in about.items() if _ascii(text) != text]
    cut = [SUBJECT] if len(code) > LONGEST_CODE else []
    return patient, recording, list(dict.fromkeys([*changed, *cut, *texts]))


def _filled(field: Any, parts: dict[str, Any], further: list[str], texts: dict[str, str]) -> Any:
    """Return a field of the header; take from the texts what it has space for."""
    whole = field(**parts, additional=further)
    for key, text in list(texts.items()):
        try:
            whole = field(**parts, additional=[*further, f"{key}={text}"])
        except ValueError:
            continue
        further = [*further, f"{key}={texts.pop(key)}"]
    return whole


def _word(text: str) -> str:
    """Return a text in ASCII, with _ in place of spaces."""
    return "_".join(_ascii(text).split())


def _ascii(text: str) -> str:
    """Return a text in ASCII: letters without their marks, u for micro, ? for the others."""
    plain = unicodedata.normalize("NFKD", plain_micro(text))
    kept = "".join(each for each in plain if not unicodedata.combining(each))
    return kept.encode("ascii", "replace").decode()
