"""Writer of an MCAP recording. Its file keeps what a full disk refuses, and tries again."""

import json
import math
import os
from collections import Counter, deque
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, cast

from protocol.errors import OutputError
from protocol.wire.messages import VERSION
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import SCHEMAS


class RetryingFile:
    """File that is written in pieces; pieces that the disk refuses are kept in order and retried.

    A partly written piece is removed again, so the file always ends with a whole piece.

    waiting_bytes, waiting: size of the pieces that are not on the disk, and messages in them.
    """

    def __init__(self, path: Path) -> None:
        """Create the file. Raises OutputError, also if it exists."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
        try:
            # A pulse is a person's: only the owner reads it, as a key.
            self._file = os.open(path, flags, 0o600)
        except FileExistsError:
            raise OutputError(f"{path}: exists already; name another file") from None
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from None
        self._unsealed = bytearray()
        # Bytes and number of messages of each piece.
        self._pieces: deque[tuple[bytes, int]] = deque()
        self._on_disk_bytes = self.waiting_bytes = self.waiting = 0

    def write(self, data: bytes) -> int:
        """Add bytes to the next piece."""
        self._unsealed += data
        return len(data)

    def tell(self) -> int:
        """Return the position of the next byte in the file."""
        return self._on_disk_bytes + self.waiting_bytes + len(self._unsealed)

    def flush(self) -> None:
        """Do nothing: only `commit` writes."""

    def commit(self, messages: int) -> str | None:
        """End the piece, which holds `messages` messages, and write what the disk accepts.

        Returns
        -------
        str or None
            Reason why pieces still wait; None when all are on the disk.
        """
        if self._unsealed:
            self._pieces.append((bytes(self._unsealed), messages))
            self.waiting_bytes += len(self._unsealed)
            self.waiting += messages
            self._unsealed.clear()
        while self._pieces:
            data, count = self._pieces[0]
            try:
                self._append(data)
            except OSError as error:
                return error.strerror or str(error)
            self._pieces.popleft()
            self.waiting_bytes -= len(data)
            self.waiting -= count
        return None

    def close(self) -> None:
        """Close the file and drop the waiting pieces."""
        os.close(self._file)

    def _append(self, data: bytes) -> None:
        """Write all of a piece, or none of it. Raises OSError."""
        left = memoryview(data)
        try:
            os.lseek(self._file, self._on_disk_bytes, os.SEEK_SET)
            while left:
                left = left[os.write(self._file, left) :]
            # The piece survives a loss of power, and write errors are raised here.
            os.fsync(self._file)
        except OSError:
            with suppress(OSError):
                os.ftruncate(self._file, self._on_disk_bytes)
            raise
        self._on_disk_bytes += len(data)


# Limit of the waiting pieces while the disk is full: about seven minutes of a 1 kHz stream.
MAX_WAITING_BYTES = 32 * 1024 * 1024
PROVENANCE, ABOUT = "telepulse.provenance", "telepulse.about"
# Limit of the runs of a display in one recording whose provenance is kept.
MAX_RUNS = 100


class McapWriter:
    """Writer of one recording. A full disk raises no error: it is retried, and drops are counted.

    written: accepted messages by topic. dropped: messages that fitted neither on the disk nor in
    memory.
    """

    def __init__(self, path: Path) -> None:
        """Create the file. Raises OutputError."""
        try:
            from mcap.writer import Writer
        except ImportError as error:
            raise OutputError(
                f"recording needs mcap, which cannot be loaded ({error});"
                " pip install 'telepulse[record]'"
            ) from None
        self._file = RetryingFile(path)
        self._writer: Any = Writer(cast(IO[Any], self._file))
        self._writer.start(profile="telepulse", library=f"telepulse, wire protocol {VERSION}")
        self._channels: dict[str, int] = {}
        for topic, (name, schema) in SCHEMAS.items():
            number = self._writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            self._channels[topic] = self._writer.register_channel(topic, "json", number)
        self._in_chunk = self._runs = 0
        self.written: Counter[str] = Counter()
        self.dropped = 0

    def add(self, entry: Entry) -> None:
        """Add a message to the present chunk."""
        self.put(entry.topic, entry.t_ns, as_json(entry.fields))

    def put(self, topic: str, t_ns: int, data: bytes) -> None:
        """Add a message with JSON data to the present chunk."""
        if self._file.waiting_bytes > MAX_WAITING_BYTES:
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
        """Add a run's provenance; after `MAX_RUNS` of them, further ones count as dropped."""
        self._runs += 1
        if self._runs > MAX_RUNS or self._file.waiting_bytes > MAX_WAITING_BYTES:
            self.dropped += 1
            return
        self._writer.add_metadata(PROVENANCE, provenance)

    def state(self, about: dict[str, str]) -> None:
        """Add what a person states about the recording."""
        self._writer.add_metadata(ABOUT, about)

    def flush(self) -> str | None:
        """End the chunk and write it; return the reason if it could not be written yet."""
        self._writer.flush()
        return self._commit()

    def close(self) -> str | None:
        """End the recording; return the reason if messages, counted as dropped, are missing."""
        self._writer.finish()
        reason = self._commit()
        self.dropped += self._file.waiting
        self._file.close()
        return reason

    def _commit(self) -> str | None:
        messages, self._in_chunk = self._in_chunk, 0
        return self._file.commit(messages)


_encode = json.JSONEncoder(allow_nan=False, separators=(",", ":")).encode


def as_json(fields: dict[str, Any]) -> bytes:
    """Return fields as JSON, which has neither NaN nor infinity: such values are left out."""
    try:
        return _encode(fields).encode()
    except ValueError:
        return _encode(_finite(fields)).encode()


def _finite(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return {
        name: _finite(inner)
        for name, inner in value.items()
        if not (isinstance(inner, float) and not math.isfinite(inner))
    }
