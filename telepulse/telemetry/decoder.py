"""Decoder of a display's telemetry into the messages of a recording. Pure: bytes in, fields out.

Each message carries the Unix time at which the display received or did it: the display's own clock,
mapped to Unix time once when a run begins, so that distances in time stay exact.
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
from telepulse.telemetry.events import Event, EventDetector
from telepulse.telemetry.schema import CLOCK, EVENT, FRAME, LEVELS, REFUSED, STATUS, STREAM, TICK

Fields = dict[str, Any]
Decoded = Frame | Welcome | ClockReply | Bye


def decode_captured(message: CapturedMessage) -> Decoded:
    """Return the content of a message that a display captured. Raises WireError."""
    if message.path != CONTROL:
        return decode_frame(message.data)
    control = decode_control(message.data)
    if isinstance(control, Welcome | ClockReply | Bye):
        return control
    raise WireError("unexpected", "a message that only displays send")


def frame_fields(message: CapturedMessage, frame: Frame) -> Fields:
    """Return a frame as it arrived: when, over which path, its exact bytes, its samples in N."""
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
        "data": _base64(message.data),
    }


def stream_fields(message: CapturedMessage, welcome: Welcome) -> Fields:
    """Return the stream's description."""
    return {
        "arrived_ns": message.arrived_ns,
        "session": welcome.session,
        "samples_sent": welcome.samples_sent,
        **welcome.description.to_wire(),
        "data": _base64(message.data),
    }


def clock_fields(message: CapturedMessage, reply: ClockReply) -> Fields:
    """Return a clock exchange: t1, t4 on the display's clock, t2, t3 on the sensing node's."""
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
    """Return a message that was refused, and the cause."""
    return {
        "arrived_ns": message.arrived_ns,
        "path": message.path,
        "cause": error.cause,
        "data": _base64(message.data),
    }


def _base64(data: bytes) -> str:
    return b64encode(data).decode("ascii")


LATEST_NS = (1 << 63) - 1
SECOND_NS = 1_000_000_000


class Entry(NamedTuple):
    """One message of a recording: its topic, its Unix time, and its fields."""

    topic: str
    t_ns: int
    fields: Fields


class TelemetryDecoder:
    """Decoder that follows one display, from run to run.

    Attributes
    ----------
    missed : Counter
        Messages of each kind that the display published and that did not arrive.
    ended : bool
        The display has sent its last status.
    provenance : dict or None
        Of the display's run; None until it arrived.
    """

    def __init__(self) -> None:
        self._run: int | None = None
        self._unix_offset_ns = self._now_ns = 0
        self._traces = self._statuses = self._captures = 0
        self._session: int | None = None
        self._events = EventDetector()
        self.missed: Counter[str] = Counter()
        self.ended = False
        self.provenance: dict[str, str] | None = None

    @property
    def started(self) -> bool:
        """Whether a run of the display has begun here."""
        return self._run is not None

    def decode(self, topic: bytes, data: bytes) -> list[Entry]:
        """Return the entries of a telemetry message; traces and statuses count from a run's begin.

        A message that cannot be read is counted in `missed`.
        """
        try:
            if topic == PROVENANCE:
                self.provenance = read_provenance(data)
            if topic == HEARD:
                return list(self._captured(read_capture(data)))
            if topic == TRACE:
                self._traces += 1
                return list(self._ticks(read_trace(data))) if self.started else []
            if topic == STATUS_TOPIC:
                self._statuses += 1
                return list(self._status(data)) if self.started else []
        except WireError:
            self.missed["unreadable messages"] += 1
        return []

    def event(self, event: Event) -> Entry:
        """Return an event as an entry, at the latest instant of the telemetry."""
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

    def _captured(self, captured: CapturedMessages) -> Iterator[Entry]:
        if captured.run != self._run:
            text = "another run of the display" if self.started else "the recording"
            self._begin(captured)
            yield self.event(Event("INFO", "begin", text))
        self._now_ns = captured.now_ns
        yield from self._account(captured)
        for message in captured.messages:
            self._now_ns = message.arrived_ns
            yield from self._message(message)

    def _begin(self, captured: CapturedMessages) -> None:
        self._run = captured.run
        self._unix_offset_ns, self._now_ns = captured.wall_ns - captured.now_ns, captured.now_ns
        self._traces, self._statuses, self._captures = (
            captured.traces,
            captured.statuses,
            captured.before,
        )
        self._events = EventDetector()

    def _account(self, captured: CapturedMessages) -> Iterator[Entry]:
        """Count what was published since the last time and did not arrive."""
        gaps = {
            "traces": captured.traces - self._traces,
            "statuses": captured.statuses - self._statuses,
            "captured messages": captured.before - self._captures,
        }
        self._traces, self._statuses = captured.traces, captured.statuses
        self._captures = captured.before + len(captured.messages)
        lost = {name: count for name, count in gaps.items() if count > 0}
        if lost:
            self.missed.update(lost)
            text = ", ".join(f"{count} {name}" for name, count in lost.items())
            yield self.event(Event("WARNING", "missed", f"the recorder missed {text}"))

    def _message(self, message: CapturedMessage) -> Iterator[Entry]:
        t_ns = self._unix_ns(message.arrived_ns)
        try:
            decoded = decode_captured(message)
        except WireError as error:
            yield Entry(REFUSED, t_ns, refused_fields(message, error))
            return
        match decoded:
            case Frame():
                yield Entry(FRAME, t_ns, frame_fields(message, decoded))
                if decoded.session == self._session:
                    for event in self._events.arrive(message.arrived_ns):
                        yield self.event(event)
            case ClockReply():
                yield Entry(CLOCK, t_ns, clock_fields(message, decoded))
            case Welcome(session=session, description=description):
                yield Entry(STREAM, t_ns, stream_fields(message, decoded))
                if session != self._session:
                    self._session = session
                    self._events.begin_session()
                    text = f"{description.name!a}, session {session}"
                    yield self.event(Event("INFO", "session", text))
            case Bye(samples_sent=count):
                self._events.end_stream()
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
        for event in self._events.take(status.state, status.summary, self._now_ns):
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
