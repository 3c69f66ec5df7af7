"""What Foxglove and other readers of MCAP need of a file: https://mcap.dev/spec, and Foxglove's
documentation of JSON messages and of foxglove.Log. Foxglove itself is not run."""

import json
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import SeekingReader
from mcap.records import Chunk, DataEnd, Footer, Header, MessageIndex
from mcap.stream_reader import StreamReader

from benchmarks.analysis import record
from telepulse.telemetry.schema import CLOCK, EVENT, FRAME, SCHEMAS, STATUS, STREAM, TICK
from tests.support.foxglove import assert_fits, assert_readable


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "a.mcap"
    record(path, 2)
    return path


def test_messages_are_json_by_schemas_that_stand_before_them(path: Path) -> None:
    with path.open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True)
        seen: Counter[str] = Counter()
        for schema, channel, message in reader.iter_messages(log_time_order=False):
            assert schema is not None
            assert schema.id > 0
            assert (channel.message_encoding, schema.encoding) == ("json", "jsonschema")
            table = json.loads(schema.data)
            if not seen[channel.topic]:
                assert_readable(table, schema.name)
            seen[channel.topic] += 1
            assert message.sequence == seen[channel.topic] - 1
            assert_fits(json.loads(message.data), table, channel.topic)
            assert message.publish_time == message.log_time
    assert set(seen) == {FRAME, TICK, CLOCK, STREAM, STATUS, EVENT}


def test_the_files_summary_has_counts_and_times(path: Path) -> None:
    with path.open("rb") as file:
        reader = SeekingReader(file)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        told = summary.statistics
        counts: Counter[int] = Counter()
        times_ns = []
        for _, channel, message in reader.iter_messages():
            counts[channel.id] += 1
            times_ns.append(message.log_time)
        # In order of time, as asked of the index.
        assert times_ns == sorted(times_ns)
    assert (told.message_count, told.channel_message_counts) == (len(times_ns), dict(counts))
    assert (told.message_start_time, told.message_end_time) == (times_ns[0], times_ns[-1])
    assert (told.schema_count, told.channel_count) == (len(SCHEMAS), len(SCHEMAS))
    assert told.chunk_count == len(summary.chunk_indexes) > 1
    for chunk in summary.chunk_indexes:
        assert chunk.message_start_time <= chunk.message_end_time
        assert chunk.message_index_length > 0


def test_every_chunk_is_followed_by_the_index_of_its_messages(path: Path) -> None:
    with path.open("rb") as file:
        records: list[Any] = list(StreamReader(file, emit_chunks=True).records)
    assert isinstance(records[0], Header)
    assert (type(records[-1]), records[-1].summary_start > 0) == (Footer, True)
    assert sum(isinstance(each, DataEnd) for each in records) == 1
    for before, each in pairwise(records):
        if isinstance(before, Chunk):
            assert isinstance(each, MessageIndex)


def test_an_event_is_a_foxglove_log(path: Path) -> None:
    name, schema = SCHEMAS[EVENT]
    assert name == "foxglove.Log"
    assert list(schema["properties"]) == ["timestamp", "level", "message", "name", "file", "line"]
    with path.open("rb") as file:
        events = list(SeekingReader(file).iter_messages(topics=[EVENT]))
    for _, _, message in events:
        fields = json.loads(message.data)
        stamp = fields["timestamp"]
        assert stamp["sec"] * 10**9 + stamp["nsec"] == message.log_time
        assert fields["level"] in (2, 3, 4)
    assert events
