"""Export of a recording as signals: other libraries read what it writes, and it names the rest."""

from pathlib import Path
from typing import Any

import edfio
import numpy as np
import pytest
import pyxdf

from sensing_node.files.formats import open_signals
from sensing_node.files.grids import find_gaps
from telepulse.recording import edf_writer, wfdb_writer, xdf_writer
from telepulse.recording.signal_export import export_signals
from telepulse.recording.signal_table import Annotation, Floats, SignalTable
from tests.support.recordings import record
from tests.support.signal_files import pulse_and_ecg

SIGNALS = pulse_and_ecg()
SIGNALS["ABP"][[100, 101, 500]] = np.nan
BEGIN_NS = 1_732_449_600_250_000_000
ABOUT = {"subject": "S01", "side": "left", "notes": "after a walk"}
TABLE = SignalTable(
    list(SIGNALS),
    ["mV", "mN", "V"],
    np.stack(list(SIGNALS.values()), axis=1),
    250,
    BEGIN_NS,
    [Annotation(0.5, "cuff"), Annotation(1.25, "lost", 0.5)],
    ABOUT,
)
WRITERS: dict[str, Any] = {".edf": edf_writer, ".hea": wfdb_writer, ".xdf": xdf_writer}


def theirs(path: Path) -> dict[str, Floats]:
    """Return the samples of a file by another library."""
    if path.suffix == ".edf":
        signals = edfio.read_edf(path).signals
        return {s.label: np.where(s.digital == s.digital_min, np.nan, s.data) for s in signals}
    if path.suffix == ".xdf":
        streams, _ = pyxdf.load_xdf(str(path))
        return {s["info"]["name"][0]: s["time_series"][:, 0] for s in streams[:3]}
    wfdb = pytest.importorskip("wfdb", reason="the package wfdb is not installed")
    values, fields = wfdb.rdsamp(str(path.with_suffix("")))
    assert (fields["fs"], fields["units"]) == (250, ["mV", "mN", "V"])
    return dict(zip(fields["sig_name"], values.T, strict=True))


@pytest.mark.filterwarnings("ignore:The inplace keyword")
@pytest.mark.parametrize("suffix", WRITERS)
def test_what_is_written_is_read_by_other_libraries_and_as_a_source(
    tmp_path: Path, suffix: str
) -> None:
    path = tmp_path / f"out{suffix}"
    WRITERS[suffix].write(path, TABLE)
    other, file = theirs(path), open_signals(path)
    assert [(s.name, s.unit, s.rate_hz) for s in file.signals] == [
        (name, unit, 250) for name, unit in zip(TABLE.names, TABLE.units, strict=True)
    ]
    for name, values in SIGNALS.items():
        (column,) = file.load((name,))
        np.testing.assert_allclose(column.values, values, atol=1e-3)
        np.testing.assert_allclose(other[name], column.values, atol=1e-9)


def test_begin_texts_and_annotations_are_in_the_file_or_in_a_note(tmp_path: Path) -> None:
    (note,) = edf_writer.write(tmp_path / "a.edf", TABLE)
    assert note.startswith("16 bits; quantisation steps: II ")
    edf = edfio.read_edf(tmp_path / "a.edf")
    assert (edf.patient.code, edf.patient.additional) == (
        "S01",
        ("side=left", "notes=after_a_walk"),
    )
    assert [(a.onset, a.duration, a.text) for a in edf.annotations] == [
        (0.5, None, "cuff"),
        (1.25, 0.5, "lost"),
    ]
    assert str(edf.startdatetime) == "2024-11-24 12:00:00.250000"
    *_, note = wfdb_writer.write(tmp_path / "a.hea", TABLE)
    assert note == "2 annotations are left out"
    header = (tmp_path / "a.hea").read_text(encoding="utf-8")
    assert "12:00:00.250000 24/11/2024" in header
    assert "# subject: S01\n# side: left\n" in header
    assert xdf_writer.write(tmp_path / "a.xdf", TABLE) == ["1 annotation is without length"]
    streams, head = pyxdf.load_xdf(str(tmp_path / "a.xdf"))
    assert head["info"]["datetime"] == ["2024-11-24 12:00:00.250000+00:00"]
    assert [row[0] for row in streams[3]["time_series"]] == ["cuff", "lost"]


def test_our_recording_is_played_and_exported_to_each_format(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    record(path, 3, {100, *range(300, 320)})
    file = open_signals(path)
    assert [(s.name, s.unit, s.rate_hz) for s in file.signals] == [("pulse", "N", 1000.0)]
    (pulse,) = file.load((0,))
    assert find_gaps(pulse.values) == (105, 2, 100)
    for suffix in WRITERS:
        line = export_signals(path, tmp_path / f"out{suffix}", suffix)
        assert "3 s at 1000 Hz, 2 losses" in line
        out = open_signals(tmp_path / f"out{suffix}")
        assert [(s.name, s.unit) for s in out.signals] == [
            ("Force pulse", "mN"),
            ("Force felt", "mN"),
        ]
        (wrist,) = out.load(("Force pulse",))
        known = ~np.isnan(pulse.values)
        np.testing.assert_allclose(
            wrist.values[: len(known)][known], 1e3 * pulse.values[known], atol=0.02
        )
    marks = [note.text for note in edfio.read_edf(tmp_path / "out.edf").annotations]
    assert "100 samples lost" in marks
