"""Provenance in a recording of the run that made it, and its reader's lines on a broken end."""

import csv
import json
from pathlib import Path

import edfio
import pytest
from pyarrow import parquet

from benchmarks.analysis import record
from protocol.provenance import PROVENANCE, collect
from telepulse.recording.edf import export_edf
from telepulse.recording.export import export_csv, export_mcap, export_parquet
from telepulse.recording.mcap_writer import MAX_RUNS, McapWriter
from telepulse.recording.reader import RecordingReader
from telepulse.recording.report.chapters import build_recording_report
from telepulse.telemetry.decoder import TelemetryDecoder
from tests.support.nodes import RADIAL


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 3 s, with its provenance."""
    folder = tmp_path_factory.mktemp("recording")
    plain, path = folder / "plain.mcap", folder / "a.mcap"
    record(plain, 3)
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


@pytest.fixture
def cut(recording: Path, tmp_path: Path) -> Path:
    """The recording, whose recorder was killed."""
    path = tmp_path / "cut.mcap"
    path.write_bytes(recording.read_bytes()[: recording.stat().st_size * 2 // 3])
    return path


def test_every_export_carries_it(recording: Path, tmp_path: Path) -> None:
    version = collect().version
    reader = RecordingReader(recording)
    assert len(list(reader)) > 3000
    assert [run["version"] for run in reader.provenance] == [version]
    export_mcap(recording, tmp_path / "b.mcap")
    again = RecordingReader(tmp_path / "b.mcap")
    assert len(list(again)) > 3000
    assert again.provenance == reader.provenance
    for kind, to in (("csv", export_csv), ("parquet", export_parquet)):
        to(recording, tmp_path / kind)
        described = json.loads((tmp_path / kind / "provenance.json").read_text(encoding="utf-8"))
        assert described["runs"] == reader.provenance
        assert described["whole"] is True
    metadata = parquet.read_schema(tmp_path / "parquet" / "ticks.parquet").metadata
    read = parquet.ParquetFile(tmp_path / "parquet" / "ticks.parquet").metadata.metadata
    assert json.loads(read[b"telepulse.runs"]) == reader.provenance, metadata
    export_edf(recording, tmp_path / "a.edf")
    notes = [note.text for note in edfio.read_edf(tmp_path / "a.edf").annotations]
    assert f"version {version}" in notes
    (chapter,) = [c for c in build_recording_report(recording).chapters if "Proven" in c.title]
    assert dict(chapter.tables[0].rows)["version"] == version


def test_reader_report_and_exports_name_how_much_of_the_end_is_missing(
    cut: Path, tmp_path: Path, logged: list[str]
) -> None:
    reader = RecordingReader(cut)
    assert len(list(reader))
    assert not reader.whole
    assert 0 < reader.cut_bytes < cut.stat().st_size
    (line,) = reader.gaps()
    assert line.startswith("breaks off after 2.0 s")
    assert f"{reader.cut_bytes} bytes" in line
    assert len(reader.provenance) == 1
    export_csv(cut, tmp_path / "csv")
    described = json.loads((tmp_path / "csv" / "provenance.json").read_text(encoding="utf-8"))
    assert (described["whole"], described["gaps"]) == (False, [line])
    assert f"{cut}: {line}" in logged
    export_edf(cut, tmp_path / "a.edf")
    assert line in [note.text for note in edfio.read_edf(tmp_path / "a.edf").annotations]
    assert f"The recording: {line}." in build_recording_report(cut).chapters[0].paragraphs


def test_all_tables_have_one_time_base_and_each_column_names_its_clock(
    recording: Path, tmp_path: Path
) -> None:
    export_csv(recording, tmp_path / "csv")
    spans = []
    for name in ("samples", "ticks", "clock", "events"):
        with (tmp_path / "csv" / f"{name}.csv").open(newline="", encoding="utf-8") as file:
            times_ns = [int(row["unix_ns"]) for row in csv.DictReader(file)]
        spans.append((times_ns[0], times_ns[-1]))
    begin_ns = min(begin for begin, _ in spans)
    assert all(0 <= at - begin_ns <= 4_000_000_000 for span in spans for at in span)
    described = json.loads((tmp_path / "csv" / "provenance.json").read_text(encoding="utf-8"))
    for table in described["columns"].values():
        for name, column in table.items():
            if name.endswith("_ns"):
                assert "clock" in column["description"] or "Unix" in column["description"], name


def test_a_flood_of_provenance_is_bounded_and_counted(tmp_path: Path) -> None:
    writer = McapWriter(tmp_path / "a.mcap")
    for number in range(MAX_RUNS + 5):
        writer.describe({"version": str(number)})
    writer.close()
    assert writer.dropped == 5
    assert (tmp_path / "a.mcap").stat().st_size < 100_000
