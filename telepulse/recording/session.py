"""One session of a recording: its description, frames, felt force and events."""

import logging
import math
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from protocol.config.quantities import count_text
from protocol.errors import SourceError, WireError
from protocol.wire.messages import Frame, Welcome, decode_control, decode_frame
from protocol.wire.stream import StreamDescription
from telepulse.recording.reader import RecordedMessage, RecordingReader
from telepulse.telemetry.decoder import PassiveReceiver
from telepulse.telemetry.schema import EVENT, FRAME, STREAM, TICK

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RecordedForce:
    """Force felt in a session, and its events, both in order of the sensing clock.

    sensing_minus_unix_ns: sensing clock minus Unix time, as at the session's first tick.
    """

    t_ns: NDArray[np.int64]
    force_n: NDArray[np.float64]
    events: list[tuple[int, str]]
    sensing_minus_unix_ns: int

    def unix_ns(self, sensing_ns: int) -> int:
        """Return the Unix time of an instant of the sensing clock."""
        return sensing_ns - self.sensing_minus_unix_ns


def felt_force(path: Path, session: int) -> RecordedForce:
    """Return force felt and events of a session, by the sensing clock. Raises SourceError."""
    receiver, apart_ns = PassiveReceiver(), 0
    t_ns: list[int] = []
    force_n: list[float] = []
    events: list[tuple[int, str]] = []
    # Before the clock is known.
    early: list[tuple[int, str]] = []
    try:
        for message in RecordingReader(path):
            fields, topic = message.fields, message.topic
            if topic == TICK:
                if receiver.session != session or not receiver.clock.ready:
                    continue
                sensing_ns = receiver.clock.remote_ns(fields["now_ns"])
                if not t_ns:
                    apart_ns = sensing_ns - message.t_ns
                    events += [(at_ns + apart_ns, text) for at_ns, text in early]
                unix_minus_display_ns = message.t_ns - fields["now_ns"]
                t_ns.append(sensing_ns)
                force_n.append(float(fields.get("felt_n", math.nan)))
                receiver.play(fields["instant_ns"])
            elif topic != EVENT:
                receiver.take(topic, fields)
            elif receiver.session == session:
                text = f"{fields['name']}: {fields['message']}"
                if t_ns:
                    at_ns = receiver.clock.remote_ns(message.t_ns - unix_minus_display_ns)
                    events.append((at_ns, text))
                else:
                    early.append((message.t_ns, text))
        times_ns = np.array(t_ns, np.int64)
    except (LookupError, ValueError, TypeError, ArithmeticError) as error:
        raise SourceError(f"{path}: a message is not telepulse's: {error!r:.80}") from None
    if not t_ns:
        raise SourceError(f"{path}: holds no tick while the sensing clock was known")
    order = np.argsort(times_ns, kind="stable")
    return RecordedForce(times_ns[order], np.array(force_n)[order], events, apart_ns)


@dataclass
class RecordedSession:
    """Frames of one session, as bytes by the number of their first sample.

    cut: how the recording breaks off, empty where it is whole. provenance: of the runs in it.
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


def longest_session(path: Path) -> RecordedSession:
    """Return the session with most samples; log what else there is and what is missing.

    Raises SourceError without any.
    """
    reader = RecordingReader(path)
    sessions: dict[int, RecordedSession] = {}
    unfit = 0
    for message in reader:
        try:
            unfit += not _take(message, sessions)
        except (WireError, ValueError, KeyError, TypeError):
            unfit += 1
    for line in reader.gaps():
        logger.warning(f"{path}: {line}")
    if unfit:
        logger.warning(f"{path}: left out: {count_text(unfit, 'frame')} unfit for their stream")
    longest = max(sessions.values(), key=lambda session: session.samples, default=None)
    if longest is None or not longest.samples:
        raise SourceError(f"{path}: holds no frame of a stream that is described")
    longest.provenance = reader.provenance
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
        if session is None:
            return False
        stream = session.description
        if (values.shape[1], values.itemsize) != (len(stream.channels), stream.bytes_per_sample):
            return False
        if len(values) > stream.batch:
            return False
        if frame.first_sample not in session.data:
            session.data[frame.first_sample] = data
            session.samples += len(values)
    return True
