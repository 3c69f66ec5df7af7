"""Reader of a recording, whole or cut short because its recorder was killed."""

import logging
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

from protocol.config.quantities import count_text
from protocol.errors import SourceError
from protocol.input_files import open_regular
from sensing_node.files.bounds import read_json
from telepulse.recording.mcap_writer import ABOUT, PROVENANCE
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import CLOCK, EVENT, FRAME, REFUSED, SCHEMAS, STREAM, TICK

logger = logging.getLogger(__name__)

# Most entries of metadata: a recorder writes at most 100 runs of some 14 each.
MOST_ENTRIES = 10_000


class RecordedMessage(NamedTuple):
    """A message of the file: topic, Unix time, and its fields as JSON."""

    topic: str
    t_ns: int
    data: bytes

    @property
    def fields(self) -> dict[str, Any]:
        """Fields of the message. Raises ValueError where its data is no table."""
        fields = read_json(self.data)
        if type(fields) is not dict:
            raise ValueError(f"not a table: {fields!r:.40}")
        return fields


class RecordingReader:
    """Reader of a recording's messages, in the order in which they were written.

    The attributes are complete once all messages were read.

    path: of the file. whole: the recording has its end. damaged: number of chunks with a wrong
    checksum, which are left out. cut_bytes: bytes at the end of the file that cannot be read.
    begin_ns, end_ns: Unix time of the first and last message. provenance: of each run of the
    display, as text by key. about: what a person stated about the recording, by key.
    """

    def __init__(self, path: Path) -> None:
        """Set the path; the file is opened when it is read. Raises SourceError without mcap."""
        try:
            from sensing_node.files import mcap_messages
        except ImportError as error:
            raise SourceError(
                f"{path}: to read a recording, mcap is needed, which cannot be loaded ({error});"
                " pip install 'telepulse[record]'"
            ) from None
        self._mcap = mcap_messages
        self.path = path
        self._begin()

    def _begin(self) -> None:
        self.whole, self.damaged, self.cut_bytes = False, 0, 0
        self.begin_ns: int | None = None
        self.end_ns = 0
        self.provenance: list[dict[str, str]] = []
        self.about: dict[str, str] = {}
        self._entries = 0

    def gaps(self) -> list[str]:
        """Return a line for each part that could not be read; complete once all was read."""
        lines = []
        if not self.whole:
            seconds = 0.0 if self.begin_ns is None else (self.end_ns - self.begin_ns) * 1e-9
            lines.append(
                f"breaks off after {seconds:.1f} s, as when the recorder was killed:"
                f" {count_text(self.cut_bytes, 'byte')} at its end cannot be read,"
                " and everything after is missing"
            )
        if self.damaged:
            lines.append(f"{count_text(self.damaged, 'damaged chunk')} left out")
        return lines

    def log_gaps(self) -> None:
        """Warn of each part that could not be read."""
        for line in self.gaps():
            logger.warning(f"{self.path}: {line}")

    def __iter__(self) -> Iterator[RecordedMessage]:
        """Read from the beginning. Raises SourceError for a file that is no recording."""
        self._begin()
        try:
            with open_regular(self.path) as file:
                yield from self._messages(file)
        except FileNotFoundError:
            raise SourceError(f"{self.path}: no such recording") from None
        except SourceError:
            raise
        except OSError as error:
            reason = error.strerror or error
            raise SourceError(f"{self.path}: cannot be read: {reason}") from None

    def _messages(self, file: IO[bytes]) -> Iterator[RecordedMessage]:
        records = self._mcap.McapRecords(file, self.path)
        channels: dict[int, str] = {}
        schemas: dict[int, str] = {}
        ours = False
        for record in records:
            match type(record).__name__:
                case "Schema":
                    schemas[record.id] = record.name
                case "Channel":
                    channels[record.id] = record.topic
                    ours = ours or schemas.get(record.schema_id) == SCHEMAS[FRAME][0]
                case "Metadata" if record.name in (PROVENANCE, ABOUT):
                    self._describe(record.name, record.metadata)
                case "Message" if ours and record.channel_id in channels:
                    if self.begin_ns is None:
                        self.begin_ns = record.log_time
                    self.end_ns = max(self.end_ns, record.log_time)
                    topic = channels[record.channel_id]
                    yield RecordedMessage(topic, record.log_time, bytes(record.data))
        self.whole, self.damaged = records.whole, records.damaged
        self.cut_bytes = records.cut_bytes
        if not ours:
            topics = ", ".join(sorted(set(channels.values())))
            held = f"its topics are {topics[:200]}" if topics else "it is empty"
            raise SourceError(f"{self.path}: holds no telepulse recording; {held}")

    def _describe(self, name: str, entries: dict[str, str]) -> None:
        """Take metadata. Raises SourceError for more than a recorder writes."""
        self._entries += len(entries)
        if self._entries > MOST_ENTRIES:
            raise SourceError(
                f"{self.path}: describes its runs in more than {MOST_ENTRIES} entries, which no"
                " recording does"
            )
        if name == ABOUT:
            self.about |= entries
        else:
            self.provenance.append(entries)


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raise SourceError for what is raised where a message is not telepulse's."""
    try:
        yield
    except (LookupError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
        raise SourceError(f"{path}: a message is not telepulse's: {error!r:.80}") from None


# Field with the time at which the display received a message, on its clock.
_RECEIVED = {FRAME: "arrived_ns", STREAM: "arrived_ns", REFUSED: "arrived_ns", CLOCK: "t4_ns"}
# Limit of the received messages that are held back until the next tick.
MAX_WAITING = 10_000


def in_tick_order(messages: Iterable[RecordedMessage]) -> Iterator[Entry]:
    """Yield each received message before the first tick that was due after it arrived.

    A recording has ticks in the blocks of the traces, each after the messages that were received
    during it.
    Raises KeyError or ValueError for a message that is not one of a telepulse recording.
    """
    waiting: deque[tuple[int, Entry]] = deque()
    for message in messages:
        entry = Entry(message.topic, message.t_ns, message.fields)
        if entry.topic in _RECEIVED or (waiting and entry.topic == EVENT):
            # An event follows the message that caused it.
            received = _RECEIVED.get(entry.topic)
            waiting.append((entry.fields[received] if received else waiting[-1][0], entry))
            if len(waiting) > MAX_WAITING:
                yield waiting.popleft()[1]
            continue
        if entry.topic == TICK:
            while waiting and waiting[0][0] <= entry.fields["now_ns"]:
                yield waiting.popleft()[1]
        yield entry
    yield from (entry for _, entry in waiting)
