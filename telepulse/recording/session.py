"""One session of a recording: its description and frames, as a sensing node sends them."""

import logging
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from protocol.config.quantities import count_text
from protocol.errors import SourceError, WireError
from protocol.wire.description import StreamDescription
from protocol.wire.messages import Frame, Welcome, decode_control, decode_frame
from telepulse.recording.mcap_reader import RecordedMessage, RecordingReader
from telepulse.telemetry.schema import FRAME, STREAM

logger = logging.getLogger(__name__)


@dataclass
class RecordedSession:
    """Frames of one session, as bytes by the number of their first sample.

    cut: description of the recording's missing end, or "". provenance: that of each run in it.
    about: what a person stated about the recording, by key.
    """

    number: int
    description: StreamDescription
    data: dict[int, bytes] = field(default_factory=dict)
    samples: int = 0
    cut: str = ""
    provenance: list[dict[str, str]] = field(default_factory=list)
    about: dict[str, str] = field(default_factory=dict)

    def frames(self) -> Iterator[Frame]:
        """Yield the frames in order."""
        for _, data in sorted(self.data.items()):
            yield decode_frame(data)


def longest_session(path: Path) -> RecordedSession:
    """Return the session with the most samples, and log gaps and further sessions.

    Raises SourceError if there is no session with samples.
    """
    reader = RecordingReader(path)
    sessions: dict[int, RecordedSession] = {}
    unfit = 0
    for message in reader:
        try:
            unfit += not _take(message, sessions)
        except (WireError, ValueError, KeyError, TypeError):
            unfit += 1
    reader.log_gaps()
    if unfit:
        logger.warning(f"{path}: left out: {count_text(unfit, 'frame')} unfit for their stream")
    longest = max(sessions.values(), key=lambda session: session.samples, default=None)
    if longest is None or not longest.samples:
        raise SourceError(f"{path}: holds no frame of a stream that is described")
    longest.provenance, longest.about = reader.provenance, reader.about
    longest.cut = "" if reader.whole else reader.gaps()[0]
    if len(sessions) > 1:
        logger.info(f"{path}: holds {len(sessions)} sessions; the longest is taken")
    return longest


def _take(message: RecordedMessage, sessions: dict[int, RecordedSession]) -> bool:
    """Add a frame or a description; return False for a frame that cannot be used."""
    if message.topic == STREAM:
        welcome = decode_control(b64decode(message.fields["data"]))
        if isinstance(welcome, Welcome):
            described = RecordedSession(welcome.session, welcome.description)
            sessions.setdefault(welcome.session, described)
    elif message.topic == FRAME:
        data = b64decode(message.fields["data"])
        frame = decode_frame(data)
        session, values = sessions.get(frame.session), frame.values
        if session is None or len(values) > session.description.batch:
            return False
        stream = session.description
        if (values.shape[1], values.itemsize) != (len(stream.channels), stream.bytes_per_sample):
            return False
        if frame.first_sample not in session.data:
            session.data[frame.first_sample] = data
            session.samples += len(values)
    return True
