"""One session of a recording: its description, frames, felt force and events."""

import logging
import math
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.config.quantities import count_text
from protocol.errors import SourceError, WireError
from protocol.summary.tables import contactors_of
from protocol.wire.messages import Frame, Welcome, decode_control, decode_frame
from protocol.wire.stream import StreamDescription
from telepulse.recording.reader import RecordedMessage, RecordingReader
from telepulse.telemetry.decoder import PassiveReceiver
from telepulse.telemetry.schema import EVENT, FRAME, STATUS, STREAM, TICK

logger = logging.getLogger(__name__)


class RecordedForce(NamedTuple):
    """Forces felt in a session in N, and its events, both by the sensing clock in ns.

    contactors: their names; empty for one without a name. forces_n: shape (ticks, contactors), NaN
    where unknown. press_n: of the finger that presses back, NaN without one.
    sensing_minus_unix_ns: sensing clock minus Unix time at the session's first tick.
    """

    t_ns: NDArray[np.int64]
    contactors: list[str]
    forces_n: NDArray[np.float64]
    events: list[tuple[int, str]]
    sensing_minus_unix_ns: int
    press_n: NDArray[np.float64]


def felt_force(path: Path, session: int) -> RecordedForce:
    """Return the forces felt and the events of a session. Raises SourceError."""
    entries = PassiveReceiver()
    receiver = entries.receiver
    # Of each tick: sensing clock, this clock minus Unix time, and forces.
    t_ns, ahead_ns, forces_n = list[int](), list[int](), list[list[float]]()
    press_n: list[float] = []
    contactors = [""]
    # Of each event: Unix time, text, and index of the last tick before it; 0 if before the first.
    events: list[tuple[int, str, int]] = []
    try:
        for message in RecordingReader(path):
            fields, topic = message.fields, message.topic
            if topic == EVENT:
                if receiver.session == session:
                    text = f"{fields['name']}: {fields['message']}"
                    events.append((message.t_ns, text, max(0, len(t_ns) - 1)))
            elif topic == STATUS:
                if receiver.session == session:
                    contactors = list(contactors_of(fields["summary"]))
            elif topic != TICK:
                entries.take(topic, fields)
            elif receiver.session == session and receiver.clock.ready:
                t_ns.append(receiver.clock.remote_ns(fields["now_ns"]))
                ahead_ns.append(t_ns[-1] - message.t_ns)
                states = (fields, *fields.get("others", ()))
                forces_n.append([float(each.get("felt_n", math.nan)) for each in states])
                press_n.append(float(fields.get("press_n", math.nan)))
                entries.play(fields["instant_ns"])
        times_ns = np.array(t_ns, np.int64)
        # A further run of the display may have other contactors.
        felt_n = np.full((len(t_ns), len(contactors)), math.nan)
        for row, known in zip(felt_n, forces_n, strict=True):
            row[: len(known)] = known[: len(row)]
    except (LookupError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
        raise SourceError(f"{path}: a message is not telepulse's: {error!r:.80}") from None
    if not t_ns:
        raise SourceError(f"{path}: holds no tick while the sensing clock was known")
    order = np.argsort(times_ns, kind="stable")
    at_ns = [(unix_ns + ahead_ns[tick], text) for unix_ns, text, tick in events]
    pressed_n = np.array(press_n)[order]
    return RecordedForce(times_ns[order], contactors, felt_n[order], at_ns, ahead_ns[0], pressed_n)


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
