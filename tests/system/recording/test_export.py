"""Exports of a recording, with the provenance of the run that made it and the gaps in it."""

import csv
import json
import re
import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import edfio
import numpy as np
import pytest
from pyarrow import parquet

from protocol.provenance import PROVENANCE, collect
from telepulse.recording.export import export_csv, export_mcap, export_parquet
from telepulse.recording.mcap_reader import RecordingReader
from telepulse.recording.mcap_writer import McapWriter
from telepulse.recording.report import build_recording_report
from telepulse.recording.signal_export import export_signals
from telepulse.telemetry.decoder import TelemetryDecoder
from telepulse.telemetry.schema import FRAME
from tests.support.nodes import RADIAL, run
from tests.support.recordings import BATCH, BEGIN_NS, DELAY_TICKS, GAIN, UNIX_NS, record

MODULE = "telepulse"
TABLES = ("samples", "ticks", "clock", "events", "beats")
TO: dict[str, Callable[[Path, Path], str]] = {
    "csv": export_csv,
    "parquet": export_parquet,
    "edf": export_signals,
}
LOWEST_CODE = -32_768
# A single frame, and a gap of a tenth of a second.
LOST = {100, *range(300, 320)}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of 3 s with losses and provenance."""
    folder = tmp_path_factory.mktemp("recording")
    plain, path = folder / "plain.mcap", folder / "pulse.mcap"
    record(plain, 3, LOST)
    decoder, writer = TelemetryDecoder(), McapWriter(path)
    assert decoder.decode(PROVENANCE, collect(RADIAL).to_bytes()) == []
    assert decoder.provenance is not None
    writer.describe(decoder.provenance)
    for message in RecordingReader(plain):
        writer.put(*message)
        if writer.written.total() % 500 == 0:
            writer.flush()
    writer.close()
    return path


@pytest.fixture(scope="module")
def exports(recording: Path) -> Path:
    """Return the folder with the recording, pulse.mcap, and its exports."""
    folder = recording.parent
    for kind, suffix in (("csv", ""), ("parquet", ".parquet"), ("edf", ".edf")):
        TO[kind](recording, folder / f"pulse{suffix}")
    return folder


@pytest.fixture
def cut(recording: Path, tmp_path: Path) -> Path:
    """Return the recording as a killed recorder leaves it."""
    path = tmp_path / "cut.mcap"
    path.write_bytes(recording.read_bytes()[: recording.stat().st_size * 2 // 3])
    return path


def sensed_n(path: Path) -> dict[int, float]:
    """Return the force of each sample by its number."""
    return {
        message.fields["first_sample"] + at: force_n
        for message in RecordingReader(path)
        if message.topic == FRAME
        for at, force_n in enumerate(message.fields["force_n"])
    }


def test_parquet_holds_what_csv_holds_with_types_and_units(exports: Path) -> None:
    for name in TABLES:
        with (exports / "pulse" / f"{name}.csv").open(newline="", encoding="utf-8") as file:
            header, *rows = csv.reader(file)
        table = parquet.read_table(exports / "pulse.parquet" / f"{name}.parquet")
        assert table.column_names == header
        columns = [column.to_pylist() for column in table.columns]
        as_text = [["" if v is None else str(v) for v in column] for column in columns]
        assert list(map(list, zip(*as_text, strict=True))) == rows
        assert len(rows) > 0
    schema = parquet.read_schema(exports / "pulse.parquet" / "samples.parquet")
    assert all(field.metadata[b"description"] for field in schema)
    for name, kind, unit in (("t_ns", "int64", b"ns"), ("force_0_n", "float", b"N")):
        field = schema.field(name)
        assert (str(field.type), field.metadata[b"unit"]) == (kind, unit)
    ticks = parquet.read_table(exports / "pulse.parquet" / "ticks.parquet")
    assert ticks["predictor_error_n"].null_count == len(ticks)
    assert str(ticks.schema.field("scored").type) == "bool"


def test_edf_holds_forces_at_their_times_with_losses_and_events(
    recording: Path, tmp_path: Path
) -> None:
    line = export_signals(recording, tmp_path / "a.edf")
    edf = edfio.read_edf(tmp_path / "a.edf")
    assert (edf.local_patient_identification, edf.reserved) == ("X X X X", "EDF+C")
    wrist, felt = edf.signals
    assert (wrist.label, felt.label) == ("Force pulse", "Force felt")
    assert {(s.physical_dimension, s.sampling_frequency) for s in edf.signals} == {("mN", 1000)}
    begin = datetime.combine(edf.startdate, edf.starttime, UTC)
    assert begin.timestamp() == pytest.approx((UNIX_NS + BEGIN_NS) * 1e-9, abs=2e-3)
    sensed = sensed_n(recording)
    step_mn = (wrist.physical_max - wrist.physical_min) / 65_535
    assert f"Force pulse {step_mn:.2g} mN" in line
    at = np.array([number for number in sensed if number < len(wrist.data)])
    expected_mn = 1e3 * np.array([sensed[number] for number in at])
    np.testing.assert_allclose(wrist.data[at], expected_mn, atol=0.51 * step_mn)
    # The felt force has its own time, once the sensing clock is known.
    later = at[(at + DELAY_TICKS > 200) & (at + DELAY_TICKS < 2_900)]
    expected_mn = 1e3 * GAIN * np.array([sensed[number] for number in later])
    np.testing.assert_allclose(felt.data[later + DELAY_TICKS], expected_mn, atol=2 * step_mn)
    # A short loss is interpolated, a long one has no values.
    alone, gap = 100 * BATCH, slice(300 * BATCH, 320 * BATCH)
    between = np.linspace(wrist.data[alone - 1], wrist.data[alone + BATCH], BATCH + 2)
    assert (felt.digital == LOWEST_CODE).sum() < 200
    np.testing.assert_allclose(wrist.data[alone : alone + BATCH], between[1:-1], atol=2 * step_mn)
    assert set(wrist.digital[gap]) == {LOWEST_CODE}
    assert set(np.flatnonzero(wrist.digital == LOWEST_CODE)) == {
        *range(gap.start, gap.stop),
        *range(3_000 - BATCH, 3_000),
    }
    notes = [(note.onset, note.duration, note.text) for note in edf.annotations]
    assert (pytest.approx(0.5), pytest.approx(0.005), "5 samples lost") in notes
    assert (pytest.approx(1.5), pytest.approx(0.1), "100 samples lost") in notes
    assert (pytest.approx(3.0, abs=0.01), None, "end: the display has ended") in notes


def described_in(folder: Path) -> dict[str, Any]:
    table: dict[str, Any] = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    return table


def test_every_export_carries_the_provenance(
    recording: Path, exports: Path, tmp_path: Path
) -> None:
    version = collect().version
    reader = RecordingReader(recording)
    assert len(list(reader)) > 3000
    assert [run["version"] for run in reader.provenance] == [version]
    export_mcap(recording, tmp_path / "b.mcap")
    again = RecordingReader(tmp_path / "b.mcap")
    assert len(list(again)) > 3000
    assert again.provenance == reader.provenance
    for folder in ("pulse", "pulse.parquet"):
        described = described_in(exports / folder)
        assert described["runs"] == reader.provenance
        assert described["whole"] is True
    read = parquet.ParquetFile(exports / "pulse.parquet" / "ticks.parquet").metadata.metadata
    assert json.loads(read[b"telepulse.runs"]) == reader.provenance
    notes = [note.text for note in edfio.read_edf(exports / "pulse.edf").annotations]
    assert f"version {version}" in notes
    (chapter,) = [c for c in build_recording_report(recording).chapters if "Proven" in c.title]
    assert dict(chapter.tables[0].rows)["version of telepulse"] == version


def test_reader_report_and_exports_name_how_much_of_the_end_is_missing(
    cut: Path, tmp_path: Path, logged: list[str]
) -> None:
    reader = RecordingReader(cut)
    assert len(list(reader))
    assert not reader.whole
    assert 0 < reader.cut_bytes < cut.stat().st_size
    (line,) = reader.gaps()
    assert re.match(r"breaks off after 2\.\d s", line)
    assert f"{reader.cut_bytes} bytes" in line
    assert len(reader.provenance) == 1
    for kind, to in TO.items():
        to(cut, tmp_path / kind)
    assert logged.count(f"{cut}: {line}") == len(TO)
    assert 1_000 < parquet.read_table(tmp_path / "parquet" / "ticks.parquet").num_rows < 3_000
    described = described_in(tmp_path / "csv")
    assert (described["whole"], described["gaps"]) == (False, [line])
    assert line in [note.text for note in edfio.read_edf(tmp_path / "edf").annotations]
    short = build_recording_report(cut).chapters[0]
    assert f"The recording: {line}." in short.paragraphs
    assert "last status, since it never ended" in short.tables[0].note


def test_the_command_writes_beside_the_recording(recording: Path, tmp_path: Path) -> None:
    path = shutil.copy(recording, tmp_path / "a.mcap")
    result = run(MODULE, "export", str(path), "--to", "parquet")
    assert (result.returncode, result.stderr) == (0, "")
    folder = path.with_suffix(".parquet")
    assert f"{folder}: 2890 samples, 3000 ticks, 60 clock" in result.stdout
    assert {file.name for file in folder.iterdir()} == {
        "provenance.json",
        *(f"{name}.parquet" for name in TABLES),
    }
