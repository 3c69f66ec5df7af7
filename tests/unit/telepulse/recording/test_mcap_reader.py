"""Reading a recording: whole, cut short, damaged, foreign, and with fields that are not ours."""

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from protocol.errors import OutputError, SourceError
from telepulse.recording.export import export_csv, export_mcap, export_parquet
from telepulse.recording.findings import read_findings
from telepulse.recording.mcap_reader import (
    MAX_WAITING,
    RecordedMessage,
    RecordingReader,
    in_tick_order,
)
from telepulse.recording.mcap_writer import McapWriter
from telepulse.recording.session import longest_session
from telepulse.recording.signal_export import export_signals
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import CLOCK, EVENT, FRAME, TICK
from tests.support.recordings import record
from tests.support.refusals import refusal_of

TICKS_A_CHUNK = 4


@pytest.fixture
def ends(path: Path) -> list[int]:
    """Write a frame and three chunks of ticks; return the end of each chunk in the file."""
    writer, ends = McapWriter(path), []
    writer.add(Entry(FRAME, 1, {"data": ""}))
    for first in range(0, 3 * TICKS_A_CHUNK, TICKS_A_CHUNK):
        for at in range(first, first + TICKS_A_CHUNK):
            writer.add(Entry(TICK, at, {"now_ns": at, "felt_n": at * 0.1}))
        assert writer.flush() is None
        ends.append(path.stat().st_size)
    assert writer.close() is None
    return ends


def ticks(path: Path) -> tuple[list[int], RecordingReader]:
    reader = RecordingReader(path)
    return [m.fields["now_ns"] for m in reader if m.topic == TICK], reader


def test_a_whole_recording_is_read_whole(path: Path, ends: list[int]) -> None:
    assert RecordedMessage(TICK, 1, b'{"now_ns":1,"felt_n":0.1}') in list(RecordingReader(path))
    numbers, reader = ticks(path)
    assert numbers == list(range(3 * TICKS_A_CHUNK))
    assert (reader.whole, reader.damaged) == (True, 0)


def test_of_a_recording_cut_anywhere_the_whole_chunks_are_read(
    path: Path, ends: list[int], tmp_path: Path
) -> None:
    cut, data = tmp_path / "cut.mcap", path.read_bytes()
    for size in range(9, ends[-1], 29):
        cut.write_bytes(data[:size])
        # A chunk is whole before its index, which follows it in the file.
        whole = sum(size >= end for end in ends) * TICKS_A_CHUNK
        try:
            numbers, reader = ticks(cut)
        except SourceError:
            assert size < ends[0]
            continue
        assert not reader.whole
        assert numbers == list(range(len(numbers)))
        assert whole <= len(numbers) <= whole + TICKS_A_CHUNK


def test_a_damaged_chunk_is_left_out_and_counted(path: Path, ends: list[int]) -> None:
    data = bytearray(path.read_bytes())
    data[ends[0] + 100] ^= 0x10
    path.write_bytes(data)
    numbers, reader = ticks(path)
    assert reader.damaged == 1
    assert numbers == [*range(TICKS_A_CHUNK), *range(2 * TICKS_A_CHUNK, 3 * TICKS_A_CHUNK)]


def test_a_recording_that_was_cut_short_is_repaired(
    path: Path, ends: list[int], tmp_path: Path, logged: list[str]
) -> None:
    copy = tmp_path / "b.mcap"
    path.write_bytes(path.read_bytes()[: ends[1] + 20])
    export_mcap(path, copy)
    numbers, reader = ticks(copy)
    assert reader.whole
    assert numbers == list(range(2 * TICKS_A_CHUNK))
    with copy.open("rb") as file:
        assert make_reader(file).get_summary() is not None
    assert "breaks off" in logged[0]
    with pytest.raises(OutputError, match="exists already"):
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
def test_a_file_that_is_no_recording_is_refused_in_one_line(
    path: Path, data: bytes | None, words: str
) -> None:
    if data is not None:
        path.write_bytes(data)
    assert refusal_of(SourceError, longest_session, path).startswith(f"{path}: {words}")


def test_a_recording_without_a_stream_cannot_be_played(path: Path, logged: list[str]) -> None:
    writer = McapWriter(path)
    writer.add(Entry(EVENT, 1, {"name": "begin"}))
    writer.add(Entry(FRAME, 1, {"data": "not base64"}))
    writer.close()
    with pytest.raises(SourceError, match="holds no frame"):
        longest_session(path)
    assert "left out: 1 frame unfit" in logged[0]


READERS: dict[str, Callable[[Path, Path], Any]] = {
    "report": lambda path, _: read_findings(path),
    "csv": export_csv,
    "parquet": export_parquet,
    "edf": export_signals,
}


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> list[RecordedMessage]:
    path = tmp_path_factory.mktemp("recording") / "good.mcap"
    record(path, 2)
    return list(RecordingReader(path))


def change(
    good: list[RecordedMessage], path: Path, change: Callable[[str, int, dict[str, Any]], None]
) -> None:
    """Write a recording with changed fields; change: of a topic, a message's number and fields."""
    writer = McapWriter(path)
    for topic, t_ns, data in good:
        fields = json.loads(data)
        change(topic, writer.written[topic], fields)
        writer.put(topic, t_ns, json.dumps(fields).encode())
    writer.close()


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("topic", "number", "name", "value"),
    [(TICK, 1_499, "now_ns", 10**30), (TICK, 1_499, "felt_n", []), (FRAME, 0, "data", "no base64")],
)
def test_a_field_that_is_not_telepulses_is_one_line_or_left_out(
    reader: str,
    topic: str,
    number: int,
    name: str,
    value: object,
    good: list[RecordedMessage],
    path: Path,
) -> None:
    def spoil(of: str, at: int, fields: dict[str, Any]) -> None:
        if (of, at) == (topic, number):
            fields[name] = value

    change(good, path, spoil)
    refusal = f"{path}: a message is not telepulse's"
    try:
        READERS[reader](path, path.with_name("out"))
    except SourceError as error:
        refusal = str(error)
    assert refusal.startswith(f"{path}: a message is not telepulse's")
    assert "\n" not in refusal


@pytest.mark.parametrize("reader", READERS)
def test_a_felt_force_that_becomes_unknown_is_read(
    reader: str, good: list[RecordedMessage], path: Path
) -> None:
    def forget(of: str, at: int, fields: dict[str, Any]) -> None:
        if of == TICK and at >= 1_500:
            del fields["felt_n"]

    change(good, path, forget)
    READERS[reader](path, path.with_name("out"))


def test_a_played_channel_that_is_missing_is_one_line(
    good: list[RecordedMessage], path: Path
) -> None:
    def misplay(of: str, at: int, fields: dict[str, Any]) -> None:
        if "playing" in fields:
            fields["playing"][0]["channel"] = 9

    change(good, path, misplay)
    with pytest.raises(SourceError, match="a message is not telepulse's"):
        read_findings(path)


def message(topic: str, **fields: int) -> RecordedMessage:
    return RecordedMessage(topic, 0, json.dumps(fields).encode())


def test_a_received_message_comes_before_the_next_due_tick() -> None:
    published = [
        message(FRAME, arrived_ns=5),
        message(CLOCK, t4_ns=20),
        message(FRAME, arrived_ns=99),
        message(EVENT),
        *(message(TICK, now_ns=now_ns) for now_ns in (4, 5, 21)),
    ]
    due = [(TICK, 4), (FRAME, 5), (TICK, 5), (CLOCK, 20), (TICK, 21), (FRAME, 99)]
    turns = in_tick_order(published)
    ordered = [(each.topic, next(iter(each.fields.values()), 0)) for each in turns]
    # An event follows the message that caused it.
    assert ordered == [*due, (EVENT, 0)]


def test_without_ticks_few_messages_wait() -> None:
    received = (message(FRAME, arrived_ns=number) for number in range(MAX_WAITING + 500))
    turns = in_tick_order(received)
    assert next(turns).fields["arrived_ns"] == 0
    assert next(received).fields["arrived_ns"] == MAX_WAITING + 1
    assert len(list(turns)) == MAX_WAITING + 498
