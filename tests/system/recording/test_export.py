import csv
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import edfio
import numpy as np
import pytest
from pyarrow import parquet

from benchmarks.analysis import AHEAD_NS, BATCH, BEGIN_NS, DELAY_TICKS, GAIN, UNIX_NS, record
from protocol.errors import OutputError
from telepulse.recording.edf import LOWEST, export_edf
from telepulse.recording.export import export_csv, export_parquet
from telepulse.recording.reader import RecordingReader
from telepulse.telemetry.schema import FRAME
from tests.support.nodes import run

MODULE = "telepulse"
TABLES = ("samples", "ticks", "clock", "events")
# A frame alone, and a hole of a tenth of a second.
LOST = {100, *range(300, 320)}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "a.mcap"
    record(path, 3, LOST)
    return path


TO = {"csv": export_csv, "parquet": export_parquet, "edf": export_edf}


def export(path: Path, kind: str, out: Path) -> str:
    return TO[kind](path, out)


def sensed_n(path: Path) -> dict[int, float]:
    """Force by the number of its sample."""
    return {
        message.fields["first_sample"] + at: force_n
        for message in RecordingReader(path)
        if message.topic == FRAME
        for at, force_n in enumerate(message.fields["force_n"])
    }


def test_parquet_holds_what_csv_holds_with_types_and_units(recording: Path, tmp_path: Path) -> None:
    said = [export(recording, kind, tmp_path / kind).split(": ")[1] for kind in ("csv", "parquet")]
    assert said[0] == said[1]
    for name in TABLES:
        with (tmp_path / "csv" / f"{name}.csv").open(newline="", encoding="utf-8") as file:
            header, *rows = csv.reader(file)
        table = parquet.read_table(tmp_path / "parquet" / f"{name}.parquet")
        assert table.column_names == header
        columns = [column.to_pylist() for column in table.columns]
        as_text = [["" if v is None else str(v) for v in column] for column in columns]
        assert list(map(list, zip(*as_text, strict=True))) == rows
        assert len(rows) > 0
    schema = parquet.read_schema(tmp_path / "parquet" / "samples.parquet")
    assert (str(schema.field("t_ns").type), str(schema.field("force_0_n").type)) == (
        "int64",
        "float",
    )
    for field in schema:
        assert field.metadata[b"description"]
    assert schema.field("force_0_n").metadata[b"unit"] == b"N"
    assert schema.field("t_ns").metadata[b"unit"] == b"ns"
    ticks = parquet.read_table(tmp_path / "parquet" / "ticks.parquet")
    assert ticks["predictor_error_n"].null_count == len(ticks)
    assert str(ticks.schema.field("scored").type) == "bool"


def test_many_rows_are_written_in_groups(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("telepulse.recording.export.ROWS_A_GROUP", 700)
    export_parquet(recording, tmp_path / "out")
    file = parquet.ParquetFile(tmp_path / "out" / "ticks.parquet")
    assert file.metadata.num_row_groups == 5
    assert file.read()["instant_ns"].to_pylist() == [
        BEGIN_NS + AHEAD_NS + (tick - DELAY_TICKS) * 1_000_000 for tick in range(3_000)
    ]


def test_edf_holds_forces_at_their_times_with_losses_and_events(
    recording: Path, tmp_path: Path
) -> None:
    said = export(recording, "edf", tmp_path / "a.edf")
    edf = edfio.read_edf(tmp_path / "a.edf")
    assert (edf.local_patient_identification, edf.reserved) == ("X X X X", "EDF+C")
    wrist, felt = edf.signals
    assert (wrist.label, felt.label) == ("Force pulse", "Force felt")
    assert {(s.physical_dimension, s.sampling_frequency) for s in edf.signals} == {("mN", 1000)}
    begin = datetime.combine(edf.startdate, edf.starttime, UTC)
    assert begin.timestamp() == pytest.approx((UNIX_NS + BEGIN_NS) * 1e-9, abs=2e-3)
    sensed = sensed_n(recording)
    step_mn = (wrist.physical_max - wrist.physical_min) / 65_535
    assert f"Force pulse {step_mn:.2g} mN" in said
    at = np.array([number for number in sensed if number < len(wrist.data)])
    expected_mn = 1e3 * np.array([sensed[number] for number in at])
    np.testing.assert_allclose(wrist.data[at], expected_mn, atol=0.51 * step_mn)
    # What was felt is there when it was felt, once the sensing clock is known.
    later = at[(at + DELAY_TICKS > 200) & (at + DELAY_TICKS < 2_900)]
    expected_mn = 1e3 * GAIN * np.array([sensed[number] for number in later])
    np.testing.assert_allclose(felt.data[later + DELAY_TICKS], expected_mn, atol=2 * step_mn)
    # A line where little is missing, no value where it is more than a line can tell.
    alone, hole = 100 * BATCH, slice(300 * BATCH, 320 * BATCH)
    between = np.linspace(wrist.data[alone - 1], wrist.data[alone + BATCH], BATCH + 2)
    assert (felt.digital == LOWEST).sum() < 200
    np.testing.assert_allclose(wrist.data[alone : alone + BATCH], between[1:-1], atol=2 * step_mn)
    assert set(wrist.digital[hole]) == {LOWEST}
    assert set(np.flatnonzero(wrist.digital == LOWEST)) == {
        *range(hole.start, hole.stop),
        *range(3_000 - BATCH, 3_000),
    }
    notes = [(note.onset, note.duration, note.text) for note in edf.annotations]
    assert (pytest.approx(0.5), pytest.approx(0.005), "5 samples lost") in notes
    assert (pytest.approx(1.5), pytest.approx(0.1), "100 samples lost") in notes
    assert (pytest.approx(3.0, abs=0.01), None, "end: the display has ended") in notes


def test_one_that_breaks_off_is_exported_with_a_notice(
    recording: Path, tmp_path: Path, logged: list[str]
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[: recording.stat().st_size * 2 // 3])
    for number, (kind, out) in enumerate((("parquet", "cut"), ("edf", "cut.edf"))):
        export(cut, kind, tmp_path / out)
        assert "breaks off" in logged[number]
    rows = parquet.read_table(tmp_path / "cut" / "ticks.parquet").num_rows
    assert 1_000 < rows < 3_000


def test_the_command_writes_beside_the_recording(recording: Path) -> None:
    result = run(MODULE, "export", str(recording), "--to", "parquet")
    assert (result.returncode, result.stderr) == (0, "")
    folder = recording.with_suffix(".parquet")
    assert f"{folder}: 2890 samples, 3000 ticks, 60 clock" in result.stdout
    assert {file.name for file in folder.iterdir()} == {
        "provenance.json",
        *(f"{name}.parquet" for name in TABLES),
    }


def test_nothing_is_written_over(recording: Path, tmp_path: Path) -> None:
    there = tmp_path / "there.edf"
    there.write_bytes(b"precious")
    result = run(MODULE, "export", str(recording), "--to", "edf", "--out", str(there))
    assert (result.returncode, result.stderr.count("\n")) == (2, 1)
    assert "is there already" in result.stderr
    assert there.read_bytes() == b"precious"


@pytest.mark.parametrize(("library", "to"), [("pyarrow", export_parquet), ("edfio", export_edf)])
def test_what_is_not_installed_is_named(
    library: str, to: Any, recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(OutputError, match=rf"needs {library}.*telepulse\[analysis\]"):
        to(recording, tmp_path / "out")
    assert not (tmp_path / "out").exists()
