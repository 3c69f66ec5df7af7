"""Every difference between signals and the file written of them has a note, in each format."""

import logging
from pathlib import Path

import edfio
import numpy as np
import pytest

from protocol.errors import OutputError
from sensing_node.files.formats import open_signals, write_signals
from sensing_node.files.signals import FileMark, SignalFile, SignalInfo, SignalTable
from telepulse.recording.conversion import convert_file
from tests.support.signal_files import Floats, pulse_and_ecg

FORMATS = ["hea", "edf", "bdf", "xdf", "parquet", "csv", "npz", "wav"]
BEGIN_NS = 1_480_000_000_123_456_000
UNITS = {"II": "mV", "ABP": "mmHg", "Kraft µ": "µN"}
ABOUT = {"subject": "S01", "side": "left", "notes": "cold hand"}


def table(begin_ns: int | None = BEGIN_NS) -> SignalTable:
    """Return signals with a gap, annotations before and after the first sample, and texts."""
    values = list(pulse_and_ecg().values())
    values[1][[3, 4]] = np.nan
    signals = [SignalInfo(n, *each, 250.0, 1000) for n, each in enumerate(UNITS.items())]
    marks = [FileMark(0.5, "cuff"), FileMark(1.25, "lost", 0.5), FileMark(1.25, "lost")]
    return SignalTable(signals, values, begin_ns, marks, ABOUT)


def read(file: SignalFile) -> tuple[list[SignalInfo], list[Floats]]:
    """Return the last signals of a file, without its times, and their samples."""
    signals = [each for each in file.signals if each.name not in ("t", "t_s")]
    return signals, [each.values for each in file.load([signal.number for signal in signals])]


def differences(old: SignalFile, new: SignalFile) -> set[str]:
    """Return the properties in which two files differ, found here by other means."""
    (infos, values), (others, other_values) = read(old), read(new)
    found = {
        "names": [each.name for each in infos] != [each.name for each in others],
        "units": [each.unit.replace("NU", "") for each in infos]
        != [each.unit.replace("NU", "") for each in others],
        "samples": [len(each) for each in values] != [len(each) for each in other_values],
        "begin": old.begin_ns not in (None, new.begin_ns),
        "annotations": [(m.text, round(m.at_s, 3)) for m in old.marks]
        != [(m.text, round(m.at_s, 3)) for m in new.marks],
        "lengths": sorted(m.length_s or 0 for m in old.marks if new.marks)
        != sorted(m.length_s or 0 for m in new.marks),
        "texts": dict(old.metadata) != {key: new.metadata.get(key) for key in old.metadata},
        "values": any(
            len(a) == len(b) and not np.array_equal(a, b, equal_nan=True)
            for a, b in zip(values, other_values, strict=True)
        ),
    }
    return {name for name, differs in found.items() if differs}


NOTES = {
    "names": ("names are changed",),
    "units": ("units are changed",),
    "samples": ("fill up whole seconds",),
    "begin": ("the begin is",),
    "annotations": ("annotation is left out", "annotations are left out"),
    "lengths": ("without length",),
    "texts": ("texts are",),
    "values": ("steps", "32-bit floats", "straight lines"),
}


@pytest.mark.parametrize("source", FORMATS)
@pytest.mark.parametrize("target", FORMATS)
def test_whatever_differs_after_a_conversion_has_a_note_and_nothing_else(
    tmp_path: Path, source: str, target: str
) -> None:
    first, second = tmp_path / f"a.{source}", tmp_path / f"b.{target}"
    write_signals(first, table())
    *_, line = convert_file(first, second)
    found = differences(open_signals(first), open_signals(second))
    for name in found:
        assert any(note in line for note in NOTES[name]), (name, line)
    for name in NOTES.keys() - found - {"values"}:
        assert not any(note in line for note in NOTES[name]), (name, line)
    rounded = target in ("hea", "edf", "bdf", "wav")
    assert ("written whole" in line) == (not found and not rounded)


@pytest.mark.parametrize(
    ("suffix", "held"),
    [
        ("edf", {"begin", "marks", "texts"}), ("bdf", {"begin", "marks", "texts"}),
        ("xdf", {"begin", "marks", "texts"}), ("hea", {"begin", "texts"}),
        ("parquet", {"begin", "texts"}), ("csv", set()), ("npz", set()), ("wav", set()),
    ],
)  # fmt: skip
def test_a_format_that_has_begin_annotations_or_texts_keeps_them(
    tmp_path: Path, suffix: str, held: set[str]
) -> None:
    path = tmp_path / f"a.{suffix}"
    notes = "; ".join(write_signals(path, table()))
    file = open_signals(path)
    assert (file.begin_ns == BEGIN_NS) == ("begin" in held)
    assert file.metadata == (ABOUT if "texts" in held else {})
    assert [mark.text for mark in file.marks] == (
        ["cuff", "lost", "lost"] if "marks" in held else []
    )
    assert ("the begin is left out" in notes) == ("begin" not in held)
    assert ("3 annotations are left out" in notes) == ("marks" not in held)
    assert ("texts are left out: subject, side, notes" in notes) == ("texts" not in held)
    # Without a begin there is none to miss.
    notes = "; ".join(write_signals(tmp_path / f"b.{suffix}", table(None)))
    assert "begin" not in notes
    assert open_signals(tmp_path / f"b.{suffix}").begin_ns is None


def test_one_of_something_is_in_the_singular(tmp_path: Path) -> None:
    whole = table()._replace(marks=[FileMark(1.0, "cuff")])
    assert "1 annotation is left out" in write_signals(tmp_path / "a.csv", whole)
    whole = table()._replace(marks=[FileMark(1.0, "cuff", 2.0)])
    assert "1 annotation is without length" in write_signals(tmp_path / "a.xdf", whole)


def test_edf_of_others_keeps_its_patient_and_recording(tmp_path: Path) -> None:
    signal = edfio.EdfSignal(pulse_and_ecg()["ABP"], 250, label="ABP", physical_dimension="mmHg")
    patient = edfio.Patient(code="S01", sex="F", name="Jane_Doe", additional=("tall",))
    recording = edfio.Recording(investigator_technician_code="T7", equipment_code="E8")
    edfio.Edf([signal], patient=patient, recording=recording).write(tmp_path / "a.edf")
    texts = {"subject": "S01", "sex": "F", "name": "Jane Doe", "recording": "tall",
             "technician": "T7", "equipment": "E8"}  # fmt: skip
    assert open_signals(tmp_path / "a.edf").metadata == texts
    *_, line = convert_file(tmp_path / "a.edf", tmp_path / "b.edf")
    assert "left out" not in line
    assert open_signals(tmp_path / "b.edf").metadata == texts
    assert edfio.read_edf(tmp_path / "b.edf").patient.code == "S01"
    long = table()._replace(metadata={"notes": "long " * 60})
    assert "texts are left out: notes" in write_signals(tmp_path / "c.edf", long)


def test_signals_that_begin_later_keep_their_times(tmp_path: Path) -> None:
    whole = table()
    later = [each._replace(begin_s=2.0) for each in whole.signals]
    whole = whole._replace(signals=later, marks=[FileMark(0.5, "cuff"), FileMark(2.5, "x")])
    write_signals(tmp_path / "a.xdf", whole)
    file = open_signals(tmp_path / "a.xdf")
    assert file.begin_ns == BEGIN_NS + 500_000_000
    assert [mark.at_s for mark in file.marks] == pytest.approx([0.0, 2.0], abs=1e-6)
    assert file.signals[0].begin_s == pytest.approx(1.5, abs=1e-6)


def test_names_are_made_distinct_and_printable(tmp_path: Path) -> None:
    names = ["a", "a", "line\nbreak", ""]
    signals = [SignalInfo(n, name, "N", 250.0) for n, name in enumerate(names)]
    whole = SignalTable(signals, [pulse_and_ecg()["II"]] * 4)
    for suffix in ("hea", "edf", "xdf", "parquet", "csv", "npz"):
        notes = "; ".join(write_signals(tmp_path / f"a.{suffix}", whole))
        assert "a is written as a 2" in notes
        held, _ = read(open_signals(tmp_path / f"a.{suffix}"))
        assert [each.name for each in held] == ["a", "a 2", "line break", "signal 3"]


def test_a_table_without_a_sample_is_not_written(tmp_path: Path) -> None:
    empty = table()._replace(values=[np.empty(0)] * 3)
    for suffix in FORMATS:
        path = tmp_path / f"a.{suffix}"
        with pytest.raises(OutputError, match="is not written, the signals have no sample"):
            write_signals(path, empty)
        assert not path.exists()


def test_pyxdf_has_no_complaint_of_our_files(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    for number, whole in enumerate((table(), table(None))):
        write_signals(tmp_path / f"{number}.xdf", whole)
        assert open_signals(tmp_path / f"{number}.xdf").notes == ()
    assert [each.message for each in caplog.records if each.levelno >= logging.WARNING] == []


def test_one_sample_is_read_back_from_each_format(tmp_path: Path) -> None:
    short = table()._replace(values=[each[:1] for each in table().values])
    for suffix in FORMATS:
        write_signals(tmp_path / f"a.{suffix}", short)
        _, values = read(open_signals(tmp_path / f"a.{suffix}"))
        assert [each[0] for each in values] == pytest.approx(
            [each[0] for each in short.values], abs=1e-6
        )
