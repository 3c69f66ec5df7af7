"""MCAP files: the frames of telepulse's recordings, and any number in messages in JSON."""

import io
import math
import os
import struct
import zlib
from array import array
from base64 import b64decode
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode

from protocol.errors import SourceError, WireError
from protocol.wire.description import Channel
from protocol.wire.messages import Welcome, decode_control, decode_frame
from sensing_node.files.bounds import MOST_SAMPLES, read_json
from sensing_node.files.grids import FREE_GAP, MOST_GAPS, evenly, unsteady
from sensing_node.files.signals import ColumnKey, Floats, SignalFile, SignalInfo, finite

MAGIC = b"\x89MCAP0\r\n"
# Largest record that is read, and largest chunk when unpacked: recorders begin a new chunk after 1
# to 8 MB.
MAX_RECORD_BYTES = 1 << 25
# Metadata are many short texts, each of which takes 20 times its length in memory.
MAX_METADATA_BYTES = 1 << 21
# Unpacked bytes for each byte of the file: a display's recording has 3 to 6, without index 13.
MOST_UNPACKED = 32
FRAME_SCHEMA, STREAM_SCHEMA = "telepulse.Frame", "telepulse.Stream"
# Most signals of a file, and tables in tables of a message.
MOST_FIELDS, DEEPEST = 256, 4
# Longest list whose items are fields.
LONGEST_LIST = 16
# Of each field: times in ns and values.
_Fields = dict[str, tuple["array[int]", "array[float]"]]
# Unit of a field by the end of its name, as telepulse names fields.
UNITS = {"_n": "N", "_mv": "mV", "_ms": "ms", "_ns": "ns"}


class McapRecords:
    """Records of an MCAP file up to the first one that is unreadable.

    The attributes are complete once all records were read.

    whole: the file has its end. damaged: chunks that cannot be unpacked or have a wrong checksum,
    which are left out. cut_bytes: bytes at the end of the file that cannot be read.
    """

    def __init__(self, file: IO[bytes], path: Path) -> None:
        """Check the first bytes. Raises SourceError."""
        self.whole = False
        self.damaged = self.cut_bytes = 0
        self._file, self._path = file, path
        self._size_bytes = os.fstat(file.fileno()).st_size
        self._unpacked_bytes = 0
        magic = file.read(len(MAGIC))
        if magic != MAGIC:
            raise SourceError(f"{path}: is {'not an MCAP file' if magic else 'empty'}")

    def __iter__(self) -> Iterator[Any]:
        """Yield schemas, channels, metadata and messages, also those in chunks.

        Raises SourceError for a file that would take more memory than its size permits.
        """
        found = self._read(self._file, self._size_bytes)
        while True:
            self.cut_bytes = self._size_bytes - self._file.tell()
            try:
                record = next(found, None)
            except OSError:
                raise
            except Exception:  # the exceptions for a broken end depend on its bytes
                return
            if record is None:
                return
            if isinstance(record, records.DataEnd):
                self.whole, self.cut_bytes = True, 0
                return
            if not isinstance(record, records.Chunk):
                yield record
                continue
            try:
                data = self._unpacked(record)
                yield from self._read(io.BytesIO(data), len(data))
            except OSError:
                raise
            except Exception:  # likewise
                self.damaged += 1

    def _read(self, file: IO[bytes], size_bytes: int) -> Iterator[Any]:
        """Yield records one by one; others, such as attachments and indexes, are passed over.

        Raises several errors for one that is broken, SourceError for one that is too long.
        """
        while head := file.read(_HEAD.size):
            opcode, length = _HEAD.unpack(head)
            if length > size_bytes - file.tell():
                raise EOFError
            if opcode not in _READ:
                file.seek(length, os.SEEK_CUR)
                continue
            most = MAX_METADATA_BYTES if opcode == Opcode.METADATA else MAX_RECORD_BYTES
            if length > most:
                raise SourceError(
                    f"{self._path}: a record has {length} bytes; at most {most} are read"
                )
            data = file.read(length)
            if opcode == Opcode.MESSAGE:
                channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(data)
                yield records.Message(channel, log_ns, data[_MESSAGE.size :], publish_ns, sequence)
            else:
                yield _READ[opcode].read(ReadDataStream(io.BytesIO(data)))

    def _unpacked(self, chunk: records.Chunk) -> bytes:
        """Return the bytes in a chunk. Raises SourceError beyond the bounds, others if damaged."""
        stated = chunk.uncompressed_size
        self._unpacked_bytes += stated
        if stated > MAX_RECORD_BYTES:
            raise SourceError(
                f"{self._path}: a chunk of {len(chunk.data)} bytes unpacks to {stated}; at most"
                f" {MAX_RECORD_BYTES} are read"
            )
        if self._unpacked_bytes > MOST_UNPACKED * self._size_bytes:
            raise SourceError(
                f"{self._path}: its {self._size_bytes} bytes unpack to more than {MOST_UNPACKED}"
                " times as many, which no recording does"
            )
        data = chunk.data
        if chunk.compression == "zstd" and zstandard.frame_content_size(data) in (-1, stated):
            data = zstandard.decompress(data, max_output_size=stated)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=stated + 1)
        if len(data) != stated or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
            raise ValueError("damaged")
        return data


_HEAD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_READ: dict[int, Any] = {
    Opcode.SCHEMA: records.Schema,
    Opcode.CHANNEL: records.Channel,
    Opcode.MESSAGE: records.Message,
    Opcode.METADATA: records.Metadata,
    Opcode.CHUNK: records.Chunk,
    Opcode.DATA_END: records.DataEnd,
}


class _Frames:
    """Frames of a recording: the samples of its longest session, by number."""

    def __init__(self) -> None:
        self._channels: dict[int, tuple[Channel, ...]] = {}
        self._sessions: dict[int, dict[int, tuple[int, Floats]]] = defaultdict(dict)

    def take(self, schema: str, data: str) -> None:
        """Take a message's exact bytes, in base64. Raises WireError or ValueError."""
        received = b64decode(data)
        if schema == STREAM_SCHEMA:
            welcome = decode_control(received)
            if isinstance(welcome, Welcome):
                self._channels[welcome.session] = welcome.description.channels
            return
        frame = decode_frame(received)
        values = frame.values.astype(np.float64)
        self._sessions[frame.session][frame.first_sample] = (frame.period_ns, values)

    def signals(self, notes: list[str]) -> list[tuple[SignalInfo, Floats]]:
        """Return the channels of the longest session; NaN where samples were lost."""
        if not self._sessions:
            return []
        number = max(self._sessions, key=lambda each: len(self._sessions[each]))
        frames = sorted(self._sessions[number].items())
        if len(self._sessions) > 1:
            notes.append(f"of {len(self._sessions)} sessions, the longest is read")
        first, (period_ns, values) = frames[0]
        width = values.shape[1]
        frames = [each for each in frames if each[1][1].shape[1] == width]
        last, (_, tail) = frames[-1]
        held = sum(len(each) for _, (_, each) in frames)
        length = last + len(tail) - first
        if length > min(MOST_GAPS * held + FREE_GAP, MOST_SAMPLES):
            raise ValueError(f"{held} samples with numbers over {length}")
        grid = np.full((length, width), np.nan)
        for at, (_, part) in frames:
            grid[at - first :][: len(part)] = part
        named = self._channels.get(number, ())
        channels = named if len(named) == width else [Channel(f"force {n}") for n in range(width)]
        return [
            (SignalInfo(n, channel.name, channel.unit, 1e9 / period_ns, length), grid[:, n])
            for n, channel in enumerate(channels)
        ]


def read(path: Path) -> SignalFile:
    """Open a file. Raises SourceError, and other errors for a damaged one."""
    channels: dict[int, tuple[str, str, str]] = {}
    schemas: dict[int, str] = {}
    frames, others, unread = _Frames(), set[str](), 0
    fields: _Fields = {}
    with path.open("rb") as file:
        mcap = McapRecords(file, path)
        for record in mcap:
            match record:
                case records.Schema():
                    schemas[record.id] = record.name
                case records.Channel():
                    schema = schemas.get(record.schema_id, "")
                    channels[record.id] = (record.topic, schema, record.message_encoding)
                case records.Message() if record.channel_id in channels:
                    topic, schema, encoding = channels[record.channel_id]
                    if encoding != "json":
                        others.add(f"{topic} ({encoding})")
                        continue
                    try:
                        _take(record, topic, schema, frames, fields)
                    except (ValueError, TypeError, KeyError, WireError):
                        unread += 1
    notes = []
    if not mcap.whole:
        notes.append(f"breaks off: {mcap.cut_bytes} bytes at its end cannot be read")
    if mcap.damaged:
        notes.append(f"damaged chunks are left out: {mcap.damaged}")
    if unread:
        notes.append(f"messages that cannot be decoded are left out: {unread}")
    if others:
        notes.append(f"only messages in JSON are read, not {', '.join(sorted(others))[:200]}")
    ours = frames.signals(notes)
    begin_ns = min((times[0] for times, _ in fields.values()), default=0)
    left_out = dict[ColumnKey, str]()
    found = ours or list(_numbers(fields, begin_ns, path, left_out))
    signals = tuple(info._replace(number=number) for number, (info, _) in enumerate(found))
    if not signals and others:
        raise SourceError(f"{path}: {notes[-1]}; convert them to JSON, or export a table of them")
    return SignalFile(path, signals, lambda number: found[number][1], tuple(notes), left_out)


def _take(
    message: records.Message, topic: str, schema: str, frames: _Frames, fields: _Fields
) -> None:
    """Take the numbers of a message. Raises several errors for one that is damaged."""
    content = read_json(message.data)
    if schema in (FRAME_SCHEMA, STREAM_SCHEMA):
        frames.take(schema, content["data"])
        return
    for name, value in _flat(content, topic, DEEPEST):
        if name not in fields and len(fields) >= MOST_FIELDS:
            continue
        times_ns, values = fields.setdefault(name, (array("q"), array("d")))
        times_ns.append(message.log_time)
        values.append(value)


def _flat(value: Any, name: str, depth: int) -> Iterator[tuple[str, float]]:
    """Yield the numbers in a table, and in tables and short lists in it, by their paths.

    NaN for null, which stands for a missing number, and for one that is too large.
    """
    if isinstance(value, dict) and depth:
        for key, inner in value.items():
            yield from _flat(inner, f"{name}.{key}", depth - 1)
    elif isinstance(value, list) and depth and len(value) <= LONGEST_LIST:
        for place, inner in enumerate(value):
            yield from _flat(inner, f"{name}[{place}]", depth - 1)
    elif value is None:
        yield name, math.nan
    elif isinstance(value, int | float) and not isinstance(value, bool):
        try:
            yield name, float(value)
        except OverflowError:
            yield name, math.nan


def _numbers(
    fields: _Fields, begin_ns: int, path: Path, left_out: dict[ColumnKey, str]
) -> Iterator[tuple[SignalInfo, Floats]]:
    for name, (times_ns, read) in fields.items():
        order = np.argsort(times_ns, kind="stable")
        since_ns = np.array(times_ns, np.int64)[order] - begin_ns
        t_s, values = since_ns.astype(np.float64) * 1e-9, finite(np.array(read)[order])
        if np.isnan(values).all():
            left_out[name] = "holds no number"
            continue
        try:
            rate_hz, even = evenly(t_s, values, path)
        except SourceError as error:
            left_out[name] = unsteady(error, path)
            continue
        plain = name.partition("[")[0]
        unit = next((unit for end, unit in UNITS.items() if plain.endswith(end)), "")
        yield SignalInfo(0, name, unit, rate_hz, len(even), float(t_s[0])), even
