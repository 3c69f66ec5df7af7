import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks.analysis import record
from protocol.errors import SourceError
from telepulse.recording.edf import export_edf
from telepulse.recording.export import export_csv, export_parquet
from telepulse.recording.mcap_writer import McapWriter
from telepulse.recording.reader import RecordedMessage, RecordingReader
from telepulse.recording.report.findings import read_findings
from telepulse.telemetry.schema import FRAME, TICK

READERS: dict[str, Callable[[Path, Path], Any]] = {
    "report": lambda path, _: read_findings(path),
    "csv": lambda path, out: export_csv(path, out),
    "parquet": lambda path, out: export_parquet(path, out),
    "edf": lambda path, out: export_edf(path, out),
}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> list[RecordedMessage]:
    path = tmp_path_factory.mktemp("recording") / "good.mcap"
    record(path, 2)
    return list(RecordingReader(path))


def spoil(good: list[RecordedMessage], path: Path, topic: str, name: str, value: object) -> None:
    """Write a recording with one field of a message replaced, late among the ticks."""
    writer, left = McapWriter(path), 1 if topic == FRAME else 1_500
    for message in good:
        data = message.data
        if message.topic == topic:
            left -= 1
            if left == 0:
                data = json.dumps(message.fields | {name: value}).encode()
        writer.put(message.topic, message.t_ns, data)
    writer.close()


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("topic", "name", "value"),
    [(TICK, "now_ns", 10**30), (TICK, "felt_n", []), (FRAME, "data", "no base64")],
)
def test_a_field_that_is_not_telepulses_is_one_line_or_left_out(
    reader: str,
    topic: str,
    name: str,
    value: object,
    good: list[RecordedMessage],
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.mcap"
    spoil(good, path, topic, name, value)
    said = ""
    try:
        READERS[reader](path, tmp_path / "out")
    except SourceError as error:
        said = str(error)
    assert said == "" or said.startswith(f"{path}: a message is not telepulse's")
    assert "\n" not in said


@pytest.mark.parametrize("reader", READERS)
def test_a_recording_whose_felt_force_becomes_unknown_is_read(
    reader: str, good: list[RecordedMessage], tmp_path: Path
) -> None:
    path, ticks = tmp_path / "a.mcap", 0
    writer = McapWriter(path)
    for message in good:
        fields = dict(message.fields)
        ticks += message.topic == TICK
        if message.topic == TICK and ticks > 1_500:
            del fields["felt_n"]
        writer.put(message.topic, message.t_ns, json.dumps(fields).encode())
    writer.close()
    READERS[reader](path, tmp_path / "out")


def test_a_display_that_plays_a_channel_that_is_not_there_is_one_line(
    good: list[RecordedMessage], tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    writer = McapWriter(path)
    for message in good:
        fields = dict(message.fields)
        if "playing" in fields:
            fields["playing"] |= {"channel": 9}
        writer.put(message.topic, message.t_ns, json.dumps(fields).encode())
    writer.close()
    with pytest.raises(SourceError, match="a message is not telepulse's"):
        read_findings(path)
