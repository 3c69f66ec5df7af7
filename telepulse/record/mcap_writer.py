"""Entries into an MCAP file, in chunks that are each on the disk within half a second."""

import json
import math
from collections import Counter
from pathlib import Path
from typing import IO, Any, cast

from protocol.errors import OutputError
from protocol.messages import VERSION
from telepulse.record.journal import Journal
from telepulse.record.schema import SCHEMAS
from telepulse.record.transcript import Entry

# While the disk is full: some seven minutes of a stream of 1 kHz.
MAX_WAITING_BYTES = 32 * 1024 * 1024
PROFILE = "telepulse"
PROVENANCE = "telepulse.provenance"
MAX_RUNS = 100


class McapWriter:
    """One recording. Nothing here raises for a disk that is full: it is retried and counted.

    written: messages by topic that were taken. dropped: messages that found no room, on the disk
    or in memory.
    """

    def __init__(self, path: Path) -> None:
        """Raises OutputError."""
        try:
            from mcap.writer import Writer
        except ImportError as error:
            raise OutputError(
                f"recording needs mcap, which cannot be loaded ({error});"
                " pip install 'telepulse[record]'"
            ) from None
        self._journal = Journal(path)
        self._writer: Any = Writer(cast(IO[Any], self._journal))
        self._writer.start(profile=PROFILE, library=f"telepulse, wire protocol {VERSION}")
        self._channels = {topic: self._register(topic) for topic in SCHEMAS}
        self._in_chunk = 0
        self.written: Counter[str] = Counter()
        self.dropped = self._runs = 0

    def add(self, entry: Entry) -> None:
        """Take a message into the present chunk."""
        self.put(entry.topic, entry.t_ns, as_json(entry.fields))

    def put(self, topic: str, t_ns: int, data: bytes) -> None:
        """Take a message that is JSON already into the present chunk."""
        if self._journal.waiting_bytes > MAX_WAITING_BYTES:
            self.dropped += 1
            return
        self._writer.add_message(
            channel_id=self._channels[topic],
            log_time=t_ns,
            publish_time=t_ns,
            data=data,
            sequence=self.written[topic] & 0xFFFF_FFFF,
        )
        self.written[topic] += 1
        self._in_chunk += 1

    def describe(self, provenance: dict[str, str]) -> None:
        """Add what produced the recording, as a metadata record.

        Of more than `MAX_RUNS` nothing is added: whoever sends them is no display.
        """
        self._runs += 1
        if self._runs > MAX_RUNS or self._journal.waiting_bytes > MAX_WAITING_BYTES:
            self.dropped += 1
            return
        self._writer.add_metadata(PROVENANCE, provenance)

    def flush(self) -> str | None:
        """End the chunk and put it on the disk. Returns why it waits, if it does."""
        self._writer.flush()
        return self._commit()

    def close(self) -> str | None:
        """End the recording. Returns why some of it, counted as dropped, could not be written."""
        self._writer.finish()
        reason = self._commit()
        self.dropped += self._journal.waiting
        self._journal.close()
        return reason

    def _commit(self) -> str | None:
        messages, self._in_chunk = self._in_chunk, 0
        return self._journal.commit(messages)

    def _register(self, topic: str) -> int:
        name, schema = SCHEMAS[topic]
        number = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
        channel: int = self._writer.register_channel(topic, "json", number)
        return channel


def as_json(fields: dict[str, Any]) -> bytes:
    try:
        return _encode(fields).encode()
    except ValueError:
        # JSON knows neither NaN nor infinity.
        return _encode(_finite(fields)).encode()


_encode = json.JSONEncoder(allow_nan=False, separators=(",", ":")).encode


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {
            name: _finite(inner)
            for name, inner in value.items()
            if not (isinstance(inner, float) and not math.isfinite(inner))
        }
    return value
