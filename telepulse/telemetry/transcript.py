"""A display's telemetry as the messages of a recording. Pure: bytes in, fields out.

Each message has the Unix time at which the display heard or did it: its own clock, brought to
Unix time once at the beginning of a run, so that distances in time stay what they were.

What the display heard from its sensing node, as fields of a recording's messages.
"""

import math
from base64 import b64encode
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

from protocol.config.quantities import count_text
from protocol.errors import WireError
from protocol.provenance import PROVENANCE, read_provenance
from protocol.wire.messages import (
    Bye,
    ClockReply,
    Frame,
    Welcome,
    decode_control,
    decode_frame,
)
from protocol.wire.status import STATUS as STATUS_TOPIC
from protocol.wire.status import read_status
from protocol.wire.telemetry import (
    CONTROL,
    HEARD,
    TRACE,
    CapturedMessage,
    CapturedMessages,
    Trace,
    read_capture,
    read_trace,
)
from telepulse.telemetry.events import Event, StatusWatch
from telepulse.telemetry.schema import CLOCK, EVENT, FRAME, LEVELS, REFUSED, STATUS, STREAM, TICK

Fields = dict[str, Any]
Decoded = Frame | Welcome | ClockReply | Bye


def decode(message: CapturedMessage) -> Decoded:
    """What a message says. Raises WireError."""
    if message.path != CONTROL:
        return decode_frame(message.data)
    control = decode_control(message.data)
    if isinstance(control, Welcome | ClockReply | Bye):
        return control
    raise WireError("unexpected", "a message that only displays send")


def frame_fields(message: CapturedMessage, frame: Frame) -> Fields:
    """A frame as it came: when, over which path, its exact bytes, and its samples in N."""
    values = frame.values
    return {
        "arrived_ns": message.arrived_ns,
        "path": message.path,
        "session": frame.session,
        "first_sample": frame.first_sample,
        "t_first_ns": frame.t_first_ns,
        "period_ns": frame.period_ns,
        "channels": values.shape[1],
        "bytes_per_sample": values.itemsize,
        "force_n": values.ravel().tolist(),
        "newest_n": float(values[-1, 0]),
        "data": _text(message.data),
    }


def stream_fields(message: CapturedMessage, welcome: Welcome) -> Fields:
    """The stream's description."""
    return {
        "arrived_ns": message.arrived_ns,
        "session": welcome.session,
        "samples_sent": welcome.samples_sent,
        **welcome.description.to_wire(),
        "data": _text(message.data),
    }


def clock_fields(message: CapturedMessage, reply: ClockReply) -> Fields:
    """A clock exchange: t1 and t4 on the display's clock, t2 and t3 on the sensing node's."""
    t4_ns = message.arrived_ns
    ahead_ns = (reply.t2_ns - reply.t1_ns + reply.t3_ns - t4_ns) / 2
    round_trip_ns = t4_ns - reply.t1_ns - (reply.t3_ns - reply.t2_ns)
    return {
        "session": reply.session,
        "t1_ns": reply.t1_ns,
        "t2_ns": reply.t2_ns,
        "t3_ns": reply.t3_ns,
        "t4_ns": t4_ns,
        "offset_ms": ahead_ns * 1e-6,
        "round_trip_ms": round_trip_ns * 1e-6,
    }


def refused_fields(message: CapturedMessage, error: WireError) -> Fields:
    """A message that is none, and why."""
    return {
        "arrived_ns": message.arrived_ns,
        "path": message.path,
        "cause": error.cause,
        "data": _text(message.data),
    }


def _text(data: bytes) -> str:
    return b64encode(data).decode("ascii")


LATEST_NS = (1 << 63) - 1
SECOND_NS = 1_000_000_000


class Entry(NamedTuple):
    """One message of a recording: its topic, when it was, and its fields."""

    topic: str
    t_ns: int
    fields: Fields


class Transcript:
    """The content of a display's telemetry, and a count of what of it never came.

    missed: how many messages of each kind the display published that did not reach us. ended:
    the display has said its last word. provenance: of the display's run, None until it came.
    """

    def __init__(self) -> None:
        self._run: int | None = None
        self._unix_offset_ns = self._now_ns = 0
        self._traces = self._statuses = self._heard = 0
        self._session: int | None = None
        self._watch = StatusWatch()
        self.missed: Counter[str] = Counter()
        self.ended = False
        self.provenance: dict[str, str] | None = None

    @property
    def known(self) -> bool:
        """True once anything came from a display."""
        return self._run is not None

    def take(self, topic: bytes, data: bytes) -> list[Entry]:
        """Return what a telemetry message adds to the recording; nothing until the display is
        known."""
        try:
            if topic == PROVENANCE:
                self.provenance = read_provenance(data)
            if topic == HEARD:
                return list(self._take_heard(read_capture(data)))
            if topic == TRACE:
                self._traces += 1
                return list(self._ticks(read_trace(data))) if self.known else []
            if topic == STATUS_TOPIC:
                self._statuses += 1
                return list(self._status(data)) if self.known else []
        except WireError:
            self.missed["unreadable messages"] += 1
        return []

    def event(self, event: Event) -> Entry:
        """Something that happened at the last instant the display told of."""
        t_ns = self._unix_ns(self._now_ns)
        sec, nsec = divmod(t_ns, SECOND_NS)
        fields = {
            "timestamp": {"sec": sec, "nsec": nsec},
            "level": LEVELS[event.level],
            "message": event.text,
            "name": event.name,
            "file": "",
            "line": 0,
        }
        return Entry(EVENT, t_ns, fields)

    def _unix_ns(self, now_ns: int) -> int:
        return min(max(0, now_ns + self._unix_offset_ns), LATEST_NS)

    def _take_heard(self, heard: CapturedMessages) -> Iterator[Entry]:
        if heard.run != self._run:
            word = "another run of the display" if self.known else "the recording"
            self._begin(heard)
            yield self.event(Event("INFO", "begin", word))
        self._now_ns = heard.now_ns
        yield from self._account(heard)
        for message in heard.messages:
            self._now_ns = message.arrived_ns
            yield from self._message(message)

    def _begin(self, heard: CapturedMessages) -> None:
        self._run = heard.run
        self._unix_offset_ns, self._now_ns = heard.wall_ns - heard.now_ns, heard.now_ns
        self._traces, self._statuses, self._heard = heard.traces, heard.statuses, heard.before
        self._watch = StatusWatch()

    def _account(self, heard: CapturedMessages) -> Iterator[Entry]:
        """Count what was published since the last time and did not come."""
        gaps = {
            "traces": heard.traces - self._traces,
            "statuses": heard.statuses - self._statuses,
            "messages heard": heard.before - self._heard,
        }
        self._traces, self._statuses = heard.traces, heard.statuses
        self._heard = heard.before + len(heard.messages)
        lost = {name: count for name, count in gaps.items() if count > 0}
        if lost:
            self.missed.update(lost)
            text = ", ".join(f"{count} {name}" for name, count in lost.items())
            yield self.event(Event("WARNING", "missed", f"the recorder missed {text}"))

    def _message(self, message: CapturedMessage) -> Iterator[Entry]:
        t_ns = self._unix_ns(message.arrived_ns)
        try:
            decoded = decode(message)
        except WireError as error:
            yield Entry(REFUSED, t_ns, refused_fields(message, error))
            return
        match decoded:
            case Frame():
                yield Entry(FRAME, t_ns, frame_fields(message, decoded))
                if decoded.session == self._session:
                    for event in self._watch.arrive(message.arrived_ns):
                        yield self.event(event)
            case ClockReply():
                yield Entry(CLOCK, t_ns, clock_fields(message, decoded))
            case Welcome(session=session, description=description):
                yield Entry(STREAM, t_ns, stream_fields(message, decoded))
                if session != self._session:
                    self._session = session
                    self._watch.begin_session()
                    text = f"{description.name!a}, session {session}"
                    yield self.event(Event("INFO", "session", text))
            case Bye(samples_sent=count):
                self._watch.end_stream()
                yield self.event(
                    Event("INFO", "end of stream", f"{count_text(count, 'sample')} sent")
                )

    def _ticks(self, trace: Trace) -> Iterator[Entry]:
        columns = [column.tolist() for column in trace]
        for values in zip(*columns, strict=True):
            fields = dict(zip(Trace._fields, values, strict=True))
            # JSON has no NaN: a field without a value is left out.
            for name in ("felt_n", "predictor_error_n"):
                if math.isnan(fields[name]):
                    del fields[name]
            self._now_ns = fields["now_ns"]
            yield Entry(TICK, self._unix_ns(self._now_ns), fields)

    def _status(self, data: bytes) -> Iterator[Entry]:
        status = read_status(data)
        fields = _without_none(status._asdict())
        if status.playing is not None:
            fields["playing"] = status.playing._asdict()
        yield Entry(STATUS, self._unix_ns(self._now_ns), fields)
        for event in self._watch.take(status.state, status.summary, self._now_ns):
            yield self.event(event)
        if status.final:
            self.ended = True
            yield self.event(Event("INFO", "end", "the display has ended"))


def _without_none(fields: Fields) -> Fields:
    return {
        name: _without_none(value) if isinstance(value, dict) else value
        for name, value in fields.items()
        if value is not None
    }
