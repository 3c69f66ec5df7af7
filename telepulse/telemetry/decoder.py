"""Decoder of a display's telemetry into the messages of a recording. Pure: bytes in, fields out.

Each message carries the Unix time at which the display received or did it: the display's own clock,
mapped to Unix time once when a run begins, so that distances in time stay exact.
"""

import math
from base64 import b64decode, b64encode
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, NamedTuple

from display_node.reception.playout import LATE_TARGET
from display_node.reception.receiver import MAX_ASKED, Receiver
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
    encode_control,
)
from protocol.wire.telemetry import (
    CONTROL,
    HEARD,
    TRACE,
    CapturedMessage,
    CapturedMessages,
    Trace,
    read_capture,
    read_status,
    read_trace,
)
from protocol.wire.telemetry import STATUS as STATUS_TOPIC
from telepulse.telemetry.events import Event, EventDetector
from telepulse.telemetry.schema import CLOCK, EVENT, FRAME, LEVELS, REFUSED, STATUS, STREAM, TICK

Fields = dict[str, Any]
LATEST_NS = (1 << 63) - 1
SECOND_NS = 1_000_000_000


class Entry(NamedTuple):
    """One message of a recording: its topic, its Unix time, and its fields."""

    topic: str
    t_ns: int
    fields: Fields


class TelemetryDecoder:
    """Decoder that follows one display, from run to run.

    missed: messages of each kind that the display published and that did not arrive. ended: the
    display has sent its last status. provenance: of the display's run; None until it arrived.
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
            self._run, self._now_ns = captured.run, captured.now_ns
            self._unix_offset_ns = captured.wall_ns - captured.now_ns
            self._traces, self._statuses = captured.traces, captured.statuses
            self._captures = captured.before
            self._events = EventDetector()
            yield self.event(Event("INFO", "begin", text))
        self._now_ns = captured.now_ns
        yield from self._account(captured)
        for message in captured.messages:
            self._now_ns = message.arrived_ns
            yield from self._message(message)

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
        arrived_ns = message.arrived_ns
        t_ns, data = self._unix_ns(arrived_ns), b64encode(message.data).decode("ascii")
        came = {"arrived_ns": arrived_ns, "path": message.path}
        try:
            if message.path != CONTROL:
                frame = decode_frame(message.data)
                yield Entry(FRAME, t_ns, {**came, **_frame_fields(frame), "data": data})
                if frame.session == self._session:
                    yield from map(self.event, self._events.arrive(arrived_ns))
                return
            control = decode_control(message.data)
            if not isinstance(control, Welcome | ClockReply | Bye):
                raise WireError("unexpected", "a message that only displays send")
        except WireError as error:
            yield Entry(REFUSED, t_ns, {**came, "cause": error.cause, "data": data})
            return
        match control:
            case ClockReply():
                yield Entry(CLOCK, t_ns, _clock_fields(control, arrived_ns))
            case Welcome(session=session, samples_sent=sent, description=description):
                fields = {"arrived_ns": arrived_ns, "session": session, "samples_sent": sent}
                yield Entry(STREAM, t_ns, {**fields, **description.to_wire(), "data": data})
                if session != self._session:
                    self._session = session
                    self._events.begin_session()
                    text = f"{description.name!a}, session {session}"
                    yield self.event(Event("INFO", "session", text))
            case Bye(samples_sent=sent):
                self._events.end_stream()
                text = f"{count_text(sent, 'sample')} sent"
                yield self.event(Event("INFO", "end of stream", text))

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
        events = self._events.take(status.state, status.summary, self._now_ns)
        yield from map(self.event, events)
        if status.final:
            self.ended = True
            yield self.event(Event("INFO", "end", "the display has ended"))


def _frame_fields(frame: Frame) -> Fields:
    """Return what a frame holds; samples in N, those of an instant side by side."""
    values = frame.values
    return {
        "session": frame.session,
        "first_sample": frame.first_sample,
        "t_first_ns": frame.t_first_ns,
        "period_ns": frame.period_ns,
        "channels": values.shape[1],
        "bytes_per_sample": values.itemsize,
        "force_n": values.ravel().tolist(),
        "newest_n": float(values[-1, 0]),
    }


def _clock_fields(reply: ClockReply, t4_ns: int) -> Fields:
    """Return a clock exchange: t1, t4 on the display's clock, t2, t3 on the sensing node's."""
    ahead_ns = (reply.t2_ns - reply.t1_ns + reply.t3_ns - t4_ns) / 2
    round_trip_ns = t4_ns - reply.t1_ns - (reply.t3_ns - reply.t2_ns)
    return {
        **asdict(reply),
        "t4_ns": t4_ns,
        "offset_ms": ahead_ns * 1e-6,
        "round_trip_ms": round_trip_ns * 1e-6,
    }


def _without_none(fields: Fields) -> Fields:
    return {
        name: _without_none(value) if isinstance(value, dict) else value
        for name, value in fields.items()
        if value is not None
    }


# More than one: a frame that came twice is a copy then, never refused.
PATHS = 2


class PassiveReceiver(Receiver):
    """The display's own receiver, fed with the entries of its telemetry or of a recording.

    Clock, delays and sample counts come out as in the display. It sends nothing: the display sent
    the clock requests.
    """

    def __init__(self) -> None:
        super().__init__("listener", 0, LATE_TARGET, PATHS)
        # Each reply is accepted once, as in the display.
        self._requests_ns: deque[int] = deque(maxlen=MAX_ASKED)

    def take(self, topic: str, fields: Fields) -> Frame | None:
        """Process an entry; return the frame in it, if the display accepted it.

        Raises KeyError, ValueError or TypeError for fields that are not those of an entry.
        """
        if topic == FRAME or (topic == REFUSED and fields["path"] != CONTROL):
            return self.on_frame(b64decode(fields["data"]), fields["arrived_ns"])
        if topic in (STREAM, REFUSED):
            self.on_control(b64decode(fields["data"]), fields["arrived_ns"])
        elif topic == CLOCK:
            reply = ClockReply(*(fields[name] for name in ("session", "t1_ns", "t2_ns", "t3_ns")))
            if reply.t1_ns not in self._requests_ns:
                self._requests_ns.append(reply.t1_ns)
                self.expect_reply(reply.t1_ns)
            self.on_control(encode_control(reply), fields["t4_ns"])
        return None

    def play(self, instant_ns: int) -> None:
        """Advance the buffer to an instant of the pulse that a tick played."""
        if self.ready:
            late_ns = 0 if self.description is None else self.description.group_delay_ns
            self.buffer.advance(instant_ns + late_ns)
