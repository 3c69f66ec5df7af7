"""Entries into an MCAP file, in chunks that are each on the disk within half a second.

The file under a recording: whole pieces go to the disk, or stay here until it takes them.
"""

import json
import math
import os
from collections import Counter, deque
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NamedTuple, cast

from protocol.errors import OutputError
from protocol.wire.messages import VERSION
from telepulse.telemetry.schema import SCHEMAS
from telepulse.telemetry.transcript import Entry

_BINARY = getattr(os, "O_BINARY", 0)


class _Piece(NamedTuple):
    data: bytes
    messages: int


class Journal:
    """Takes a recording's bytes and keeps what the disk refuses, in order, to try it again.

    A piece that fits in part is taken off the disk again: what stands there is always a row of
    whole pieces. waiting_bytes, waiting: bytes and messages that are not on the disk.
    """

    def __init__(self, path: Path) -> None:
        """Raises OutputError: where it cannot be made, and where a file is there already."""
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | _BINARY, 0o666)
        except FileExistsError:
            raise OutputError(f"{path}: is there already; name another file") from None
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from None
        self._path = path
        self._unsealed = bytearray()
        self._pieces: deque[_Piece] = deque()
        self._given_bytes = self._on_disk_bytes = 0
        self.waiting_bytes = self.waiting = 0

    def write(self, data: bytes) -> int:
        """Take bytes; they are a part of the next piece."""
        self._unsealed += data
        self._given_bytes += len(data)
        return len(data)

    def tell(self) -> int:
        """Where in the file the next byte will be."""
        return self._given_bytes

    def flush(self) -> None:
        """Nothing: `commit` says when."""

    def commit(self, messages: int) -> str | None:
        """Make a piece of what was taken, with so many messages, and put on the disk what fits.

        Returns why something waits, None when nothing does.
        """
        if self._unsealed:
            self._pieces.append(_Piece(bytes(self._unsealed), messages))
            self.waiting_bytes += len(self._unsealed)
            self.waiting += messages
            self._unsealed.clear()
        while self._pieces:
            piece = self._pieces[0]
            try:
                self._append(piece.data)
            except OSError as error:
                return error.strerror or str(error)
            self._pieces.popleft()
            self.waiting_bytes -= len(piece.data)
            self.waiting -= piece.messages
        return None

    def close(self) -> None:
        """Close the file; what waits is given up."""
        os.close(self._file)

    def _append(self, data: bytes) -> None:
        """All of a piece, or none of it. Raises OSError."""
        left = memoryview(data)
        try:
            os.lseek(self._file, self._on_disk_bytes, os.SEEK_SET)
            while left:
                left = left[os.write(self._file, left) :]
            # Into the disk itself: it outlives a loss of power, and what fails late fails here.
            os.fsync(self._file)
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._file, self._on_disk_bytes)
            raise
        self._on_disk_bytes += len(data)


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
