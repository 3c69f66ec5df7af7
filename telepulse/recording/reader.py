"""Reads a recording, also one whose end is missing because its recorder was killed."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

from protocol.config.quantities import count_text
from protocol.errors import SourceError
from telepulse.recording.mcap_writer import PROVENANCE
from telepulse.telemetry.schema import FRAME, SCHEMAS

MAX_RECORD_BYTES = 1 << 28
OURS = SCHEMAS[FRAME][0]


class RecordedMessage(NamedTuple):
    """A message as it stands in the file; t_ns in Unix time, `data` is JSON."""

    topic: str
    t_ns: int
    data: bytes

    @property
    def fields(self) -> dict[str, Any]:
        """The message's fields. Raises ValueError where its data is no table."""
        try:
            fields = json.loads(self.data)
        except RecursionError:
            raise ValueError("nested too deep") from None
        if type(fields) is not dict:
            raise ValueError(f"not a table: {fields!r:.40}")
        return fields


class RecordingReader:
    """The messages of a recording, in the order in which they were written.

    whole: the recording was ended as it should be; known once all was read. damaged: chunks
    whose bytes are not what was written; what is in them is left out. cut_bytes: at its end, which
    cannot be read. begin_ns, end_ns: Unix time of its first and last message. provenance: of each
    run of the display, as text by key.
    """

    def __init__(self, path: Path) -> None:
        """Raises SourceError when mcap is not installed."""
        try:
            from mcap import stream_reader
        except ImportError as error:
            raise SourceError(
                f"{path}: to read a recording, mcap is needed, which cannot be loaded ({error});"
                " pip install 'telepulse[record]'"
            ) from None
        self._mcap: Any = stream_reader
        self._path = path
        self._forget()

    def _forget(self) -> None:
        self.whole = False
        self.damaged = self.cut_bytes = 0
        self.begin_ns: int | None = None
        self.end_ns = 0
        self.provenance: list[dict[str, str]] = []

    def gaps(self) -> list[str]:
        """Return what could not be read, one line each; complete once all was read."""
        lines = []
        if not self.whole:
            seconds = 0.0 if self.begin_ns is None else (self.end_ns - self.begin_ns) * 1e-9
            lines.append(
                f"breaks off after {seconds:.1f} s, as of a recorder that was killed:"
                f" {count_text(self.cut_bytes, 'byte')} at its end cannot be read,"
                " and what was to come is missing"
            )
        if self.damaged:
            lines.append(f"{count_text(self.damaged, 'damaged chunk')} left out")
        return lines

    def __iter__(self) -> Iterator[RecordedMessage]:
        """Raises SourceError when the file is no recording, or holds nothing."""
        self._forget()
        try:
            with self._path.open("rb") as file:
                yield from self._messages(file)
        except FileNotFoundError:
            raise SourceError(f"{self._path}: no such recording") from None
        except SourceError:
            raise
        except OSError as error:
            reason = error.strerror or error
            raise SourceError(f"{self._path}: cannot be read: {reason}") from None

    def _messages(self, file: IO[bytes]) -> Iterator[RecordedMessage]:
        self._check_magic(file)
        channels: dict[int, str] = {}
        schemas: dict[int, str] = {}
        topics: set[str] = set()
        ours = False
        for record in self._records(file):
            match type(record).__name__:
                case "Schema":
                    schemas[record.id] = record.name
                case "Channel":
                    channels[record.id] = record.topic
                    topics.add(record.topic)
                    ours = ours or schemas.get(record.schema_id) == OURS
                case "Metadata" if record.name == PROVENANCE:
                    self.provenance.append(dict(record.metadata))
                case "Message" if ours and record.channel_id in channels:
                    if self.begin_ns is None:
                        self.begin_ns = record.log_time
                    self.end_ns = max(self.end_ns, record.log_time)
                    yield RecordedMessage(
                        channels[record.channel_id], record.log_time, bytes(record.data)
                    )
        if not ours:
            held = f"its topics are {', '.join(sorted(topics))[:200]}" if topics else "it is empty"
            raise SourceError(f"{self._path}: holds no telepulse recording; {held}")

    def _check_magic(self, file: IO[bytes]) -> None:
        magic = file.read(len(_MAGIC))
        if not magic:
            raise SourceError(f"{self._path}: is empty")
        if magic != _MAGIC:
            raise SourceError(f"{self._path}: is not an MCAP file")
        file.seek(0)

    def _records(self, file: IO[bytes]) -> Iterator[Any]:
        """The records of the data section, those of chunks too, up to where the file breaks off."""
        records = self._mcap.StreamReader(
            _Left(file), emit_chunks=True, record_size_limit=MAX_RECORD_BYTES
        ).records
        size_bytes = os.fstat(file.fileno()).st_size
        while True:
            self.cut_bytes = size_bytes - file.tell()
            try:
                record = next(records)
            except StopIteration:
                return
            except OSError:
                raise
            except Exception:  # at a file's broken end it raises whatever the bytes lead it to
                return
            kind = type(record).__name__
            if kind == "DataEnd":
                self.whole, self.cut_bytes = True, 0
                return
            if kind != "Chunk":
                yield record
                continue
            try:
                inner = self._mcap.breakup_chunk(record, validate_crc=True)
            except Exception:  # likewise
                self.damaged += 1
                continue
            yield from inner


class _Left:
    """A file of which no more is read than there is: reading makes room for all that is asked,
    and damaged lengths ask for gigabytes."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._size = os.fstat(file.fileno()).st_size

    def read(self, count: int) -> bytes:
        return self._file.read(min(count, max(0, self._size - self._file.tell())))


_MAGIC = b"\x89MCAP0\r\n"
