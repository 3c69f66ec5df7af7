"""A recording as tables of CSV, or as a whole MCAP file again."""

import csv
from base64 import b64decode
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import Any

from protocol.errors import OutputError, SourceError
from protocol.messages import decode_frame
from telepulse.record.mcap_writer import McapWriter
from telepulse.record.reader import RecordedMessage, RecordingReader
from telepulse.record.schema import CLOCK, EVENT, FRAME, SCHEMAS, TICK

Row = list[Any]
TABLES = {FRAME: "samples", TICK: "ticks", CLOCK: "clock", EVENT: "events"}
MESSAGES_A_CHUNK = 5_000
_SAMPLE = ["arrived_ns", "path", "session", "sample", "t_ns"]
_EVENT = ["level", "name", "message"]


def export_csv(path: Path, folder: Path, log: Callable[[str], None]) -> None:
    """Write a recording's tables into a new folder. Raises SourceError or OutputError."""
    reader, tables = RecordingReader(path), _Tables(folder)
    try:
        with tables:
            for message in reader:
                if message.topic in TABLES:
                    tables.add(message)
    except FileExistsError:
        raise OutputError(f"{folder}: is there already; name another by --out") from None
    except SourceError:
        raise
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None
    except (KeyError, ValueError, TypeError) as error:
        raise SourceError(f"{path}: a message is not telepulse's: {error!r:.80}") from None
    _say_gaps(path, reader, log)
    log(f"{folder}: " + ", ".join(f"{tables.rows[t]} {name}" for t, name in TABLES.items()))


class _Tables(ExitStack):
    """A file a topic, in a folder that is made for the first message. rows: in each of them."""

    def __init__(self, folder: Path) -> None:
        super().__init__()
        self._folder = folder
        self._writers: dict[str, Any] = {}
        self.rows: Counter[str] = Counter()

    def add(self, message: RecordedMessage) -> None:
        """Write a message's rows. Raises OSError; KeyError, ValueError, TypeError of its fields."""
        if message.topic not in self._writers:
            self._writers[message.topic] = self._open(message)
        for row in _rows(message):
            self._writers[message.topic].writerow(row)
            self.rows[message.topic] += 1

    def _open(self, first: RecordedMessage) -> Any:
        if not self._writers:
            self._folder.mkdir(parents=True)
        path = self._folder / f"{TABLES[first.topic]}.csv"
        writer = csv.writer(self.enter_context(path.open("w", newline="", encoding="utf-8")))
        writer.writerow(_header(first))
        return writer


def export_mcap(path: Path, copy: Path, log: Callable[[str], None]) -> None:
    """Write what can be read of a recording as a whole one. Raises SourceError or OutputError."""
    reader = RecordingReader(path)
    messages = (message for message in reader if message.topic in SCHEMAS)
    # What cannot be read leaves no file behind.
    first = next(messages, None)
    if first is None:
        raise SourceError(f"{path}: holds no message")
    writer = McapWriter(copy)
    for number, message in enumerate(chain([first], messages)):
        writer.put(*message)
        if number % MESSAGES_A_CHUNK == 0:
            writer.flush()
    reason = writer.close()
    if reason is not None or writer.dropped:
        raise OutputError(f"{copy}: cannot be written: {reason or 'the disk was full'}")
    _say_gaps(path, reader, log)
    log(f"{copy}: {sum(writer.written.values())} messages")


def _header(message: RecordedMessage) -> Row:
    match message.topic:
        case "/frame":
            channels = decode_frame(b64decode(message.fields["data"])).values.shape[1]
            return [*_SAMPLE, *(f"force_{n}_n" for n in range(channels))]
        case "/event":
            return ["t_ns", *_EVENT]
    return list(SCHEMAS[message.topic][1]["properties"])


def _rows(message: RecordedMessage) -> Iterator[Row]:
    fields = message.fields
    match message.topic:
        case "/frame":
            frame = decode_frame(b64decode(fields["data"]))
            head = [fields["arrived_ns"], fields["path"], frame.session]
            for at, values in enumerate(frame.values.tolist()):
                t_ns = frame.t_first_ns + at * frame.period_ns
                yield [*head, frame.first_sample + at, t_ns, *values]
        case "/event":
            yield [message.t_ns, *(fields[name] for name in _EVENT)]
        case topic:
            yield [fields.get(name, "") for name in SCHEMAS[topic][1]["properties"]]


def _say_gaps(path: Path, reader: RecordingReader, log: Callable[[str], None]) -> None:
    if not reader.whole:
        log(f"{path}: breaks off, as of a recorder that was killed; what is whole is taken")
    if reader.damaged:
        log(f"{path}: {reader.damaged} damaged chunks are left out")
