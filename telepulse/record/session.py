"""One session out of a recording: its description and its frames."""

from base64 import b64decode
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from protocol.counted import counted
from protocol.errors import SourceError, WireError
from protocol.messages import Frame, Welcome, decode_control, decode_frame
from protocol.stream import StreamDescription
from telepulse.record.reader import RecordedMessage, RecordingReader
from telepulse.record.schema import FRAME, STREAM


@dataclass
class Session:
    """The frames of one session, as bytes by the number of their first sample.

    cut: how the recording breaks off, "" where it is whole. provenance: of the recording's runs.
    """

    number: int
    description: StreamDescription
    data: dict[int, bytes] = field(default_factory=dict)
    samples: int = 0
    cut: str = ""
    provenance: list[dict[str, str]] = field(default_factory=list)

    def frames(self) -> Iterator[Frame]:
        """Yield the frames in order."""
        for _, data in sorted(self.data.items()):
            yield decode_frame(data)

    def fits(self, frame: Frame) -> bool:
        """Return whether the stream can hold such a frame."""
        description, values = self.description, frame.values
        return (
            values.shape[1] == len(description.channels)
            and values.itemsize == description.bytes_per_sample
            and values.shape[0] <= description.batch
        )


def longest_session(path: Path, log: Callable[[str], None]) -> Session:
    """The session with most samples; `log` is told what else there is and what is missing.

    Raises SourceError when there is none.
    """
    reader = RecordingReader(path)
    sessions: dict[int, Session] = {}
    unfit = 0
    for message in reader:
        try:
            unfit += not _take(message, sessions)
        except (WireError, ValueError, KeyError, TypeError):
            unfit += 1
    for line in reader.gaps():
        log(f"{path}: {line}")
    if unfit:
        log(f"{path}: left out: {counted(unfit, 'frame')} unfit for their stream")
    longest = max(sessions.values(), key=lambda session: session.samples, default=None)
    if longest is None or not longest.samples:
        raise SourceError(f"{path}: holds no frame of a stream that is described")
    longest.provenance = reader.provenance
    longest.cut = "" if reader.whole else reader.gaps()[0]
    if len(sessions) > 1:
        log(f"{path}: holds {len(sessions)} sessions; the longest is taken")
    return longest


def _take(message: RecordedMessage, sessions: dict[int, Session]) -> bool:
    """Add a frame or a description; False for a frame that cannot be used."""
    if message.topic == STREAM:
        welcome = decode_control(b64decode(message.fields["data"]))
        if isinstance(welcome, Welcome):
            session = Session(welcome.session, welcome.description)
            sessions.setdefault(welcome.session, session)
    elif message.topic == FRAME:
        data = b64decode(message.fields["data"])
        frame = decode_frame(data)
        found = sessions.get(frame.session)
        if found is None or not found.fits(frame):
            return False
        if frame.first_sample not in found.data:
            found.data[frame.first_sample] = data
            found.samples += len(frame.values)
    return True
