import io
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from protocol.errors import OutputError, SourceError
from telepulse.recording.export import export_mcap
from telepulse.recording.mcap_writer import McapWriter
from telepulse.recording.reader import RecordedMessage, RecordingReader
from telepulse.recording.session import longest_session
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import EVENT, FRAME, SCHEMAS, TICK

TICKS_A_CHUNK = 4


def recording(path: Path, chunks: int = 3) -> list[int]:
    """A recording of ticks with a frame at first; where each chunk ends in the file."""
    writer, ends = McapWriter(path), []
    writer.add(Entry(FRAME, 1, {"data": ""}))
    for chunk in range(chunks):
        for number in range(TICKS_A_CHUNK):
            at = chunk * TICKS_A_CHUNK + number
            writer.add(Entry(TICK, at, {"now_ns": at, "felt_n": at * 0.1}))
        assert writer.flush() is None
        ends.append(path.stat().st_size)
    assert writer.close() is None
    return ends


def ticks(path: Path) -> tuple[list[int], RecordingReader]:
    reader = RecordingReader(path)
    return [m.fields["now_ns"] for m in reader if m.topic == TICK], reader


def test_a_whole_recording_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    recording(path)
    assert RecordedMessage(TICK, 1, b'{"now_ns":1,"felt_n":0.1}') in list(RecordingReader(path))
    numbers, reader = ticks(path)
    assert numbers == list(range(3 * TICKS_A_CHUNK))
    assert reader.whole
    assert reader.damaged == 0


def test_mcaps_own_reader_finds_topics_schemas_and_an_index(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    recording(path)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        assert summary is not None
        topics = {channel.topic: channel for channel in summary.channels.values()}
        assert set(topics) == set(SCHEMAS)
        for topic, channel in topics.items():
            schema = summary.schemas[channel.schema_id]
            assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
            assert schema.name == SCHEMAS[topic][0]
        assert len(summary.chunk_indexes) == 3


def test_cut_anywhere_all_chunks_before_are_read_and_nothing_else(tmp_path: Path) -> None:
    path, cut = tmp_path / "a.mcap", tmp_path / "cut.mcap"
    ends = recording(path)
    data = path.read_bytes()
    for size in range(9, ends[-1], 29):
        cut.write_bytes(data[:size])
        # A chunk's index follows it in the file; it is whole before that has come.
        whole = sum(size >= end for end in ends) * TICKS_A_CHUNK
        try:
            numbers, reader = ticks(cut)
        except SourceError:
            assert size < ends[0]
            continue
        assert not reader.whole
        assert numbers == list(range(len(numbers)))
        assert whole <= len(numbers) <= whole + TICKS_A_CHUNK


def test_a_damaged_chunk_is_left_out_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    ends = recording(path)
    data = bytearray(path.read_bytes())
    data[ends[0] + 100] ^= 0x10
    path.write_bytes(data)
    numbers, reader = ticks(path)
    assert reader.damaged == 1
    assert numbers == [*range(TICKS_A_CHUNK), *range(2 * TICKS_A_CHUNK, 3 * TICKS_A_CHUNK)]


def test_one_that_was_cut_becomes_whole_again(tmp_path: Path, logged: list[str]) -> None:
    path, copy = tmp_path / "a.mcap", tmp_path / "b.mcap"
    ends = recording(path)
    path.write_bytes(path.read_bytes()[: ends[1] + 20])
    export_mcap(path, copy)
    numbers, reader = ticks(copy)
    assert reader.whole
    assert numbers == list(range(2 * TICKS_A_CHUNK))
    with copy.open("rb") as file:
        assert make_reader(file).get_summary() is not None
    assert "breaks off" in logged[0]
    with pytest.raises(OutputError, match="is there already"):
        export_mcap(path, copy)


def foreign() -> bytes:
    file = io.BytesIO()
    writer: Any = Writer(file)
    writer.start()
    channel = writer.register_channel("/robot", "json", 0)
    writer.add_message(channel, 1, b"{}", 1)
    writer.finish()
    return file.getvalue()


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is empty"),
        (b"\x89MCAP", "is not an MCAP file"),
        (b"force\n0.1\n0.2\n", "is not an MCAP file"),
        (b"\x89MCAP0\r\n", "holds no telepulse recording; it is empty"),
        (b"\x89MCAP0\r\n" + b"\xff" * 100, "holds no telepulse recording"),
        (foreign(), "holds no telepulse recording; its topics are /robot"),
        (None, "no such recording"),
    ],
)
def test_what_is_no_recording_is_one_line(tmp_path: Path, data: bytes | None, words: str) -> None:
    path = tmp_path / "x.mcap"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(SourceError) as caught:
        longest_session(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: {words}")
    assert "\n" not in text


def test_a_recording_without_a_stream_cannot_be_played(tmp_path: Path, logged: list[str]) -> None:
    path = tmp_path / "x.mcap"
    writer = McapWriter(path)
    writer.add(Entry(EVENT, 1, {"name": "begin"}))
    writer.add(Entry(FRAME, 1, {"data": "not base64"}))
    writer.close()
    with pytest.raises(SourceError, match="holds no frame"):
        longest_session(path)
    assert "left out: 1 frame unfit" in logged[0]
