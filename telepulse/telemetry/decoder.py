"""Decoder of a display's telemetry into the messages of a recording. Pure: bytes in, fields out.

Each message has the Unix time of the display's event. The display's monotonic clock is mapped to
Unix time once, when a run begins, so that time differences stay exact.
"""

import math
from base64 import b64decode, b64encode
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from display_node.reception.link_delay import LATE_TARGET
from display_node.reception.receiver import MAX_OPEN_REQUESTS, Receiver
from protocol.config.quantities import count_text
from protocol.errors import WireError
from protocol.provenance import PROVENANCE, read_provenance
from protocol.wire import messages as wire
from protocol.wire import telemetry
from protocol.wire.marks import MARK, Mark, read_mark
from telepulse.telemetry.events import Event, EventDetector
from telepulse.telemetry.schema import CLOCK, EVENT, FRAME, LEVELS, REFUSED, STATUS, STREAM, TICK

Fields = dict[str, Any]
# Name of the event of a mark.
MARK_EVENT = "mark"
LATEST_NS = (1 << 63) - 1


class Entry(NamedTuple):
    """One message of a recording: its topic, its Unix time, and its fields."""

    topic: str
    t_ns: int
    fields: Fields


class TelemetryDecoder:
    """Decoder of the telemetry of one display, over any number of its runs.

    reader, product: who reads the telemetry, and what becomes of it, as the events name them.
    now_ns: latest instant of the telemetry, on the display's clock. missed: counts by kind of
    messages that did not arrive or could not be read. ended: the display has sent its last status.
    provenance: of the display's run; None before it arrives. last_mark: newest mark of the run.
    """

    def __init__(self, reader: str = "the recorder", product: str = "the recording") -> None:
        self._reader, self._product = reader, product
        self._run: int | None = None
        self._unix_offset_ns = self.now_ns = 0
        # Messages of each kind that arrived, plus those published before this decoder began.
        self._arrived: Counter[str] = Counter()
        self._session: int | None = None
        self._events = EventDetector()
        self.missed: Counter[str] = Counter()
        self.ended = False
        self.provenance: dict[str, str] | None = None
        self.last_mark: Mark | None = None

    @property
    def started(self) -> bool:
        """True once captured messages have announced a run of the display."""
        return self._run is not None

    def decode(self, topic: bytes, data: bytes) -> list[Entry]:
        """Return the entries of a telemetry message.

        Traces and statuses are ignored until the first captured messages have announced a run. A
        message that cannot be read is counted in `missed`.
        """
        try:
            if topic == PROVENANCE:
                self.provenance = read_provenance(data)
            elif topic == telemetry.CAPTURE:
                return list(self._captured(telemetry.read_capture(data)))
            elif topic == telemetry.TRACE:
                self._arrived["traces"] += 1
                return list(self._ticks(telemetry.read_trace(data))) if self.started else []
            elif topic == telemetry.STATUS:
                self._arrived["statuses"] += 1
                return list(self._status(telemetry.read_status(data))) if self.started else []
            elif topic == MARK:
                return list(self._mark(read_mark(data)))
        except WireError:
            self.missed["unreadable messages"] += 1
        return []

    def event(self, event: Event, age_ns: int = 0) -> Entry:
        """Return an event as an entry, `age_ns` before the latest instant of the telemetry."""
        fields = {"level": LEVELS[event.level], "message": event.text, "name": event.name}
        entry = self._entry(EVENT, fields | {"file": "", "line": 0})
        entry = entry._replace(t_ns=max(0, entry.t_ns - age_ns))
        sec, nsec = divmod(entry.t_ns, 1_000_000_000)
        entry.fields["timestamp"] = {"sec": sec, "nsec": nsec}
        return entry

    def _entry(self, topic: str, fields: Fields) -> Entry:
        return Entry(topic, min(max(0, self.now_ns + self._unix_offset_ns), LATEST_NS), fields)

    def _captured(self, captured: telemetry.CapturedMessages) -> Iterator[Entry]:
        self.now_ns = captured.now_ns
        published = Counter(traces=captured.traces_published, statuses=captured.statuses_published)
        published["captured messages"] = captured.before
        if captured.run != self._run:
            text = "another run of the display" if self.started else self._product
            self._run, self._arrived = captured.run, published
            self._unix_offset_ns = captured.wall_ns - captured.now_ns
            self._events, self.last_mark = EventDetector(), None
            yield self.event(Event("INFO", "begin", text))
        lost = published - self._arrived
        self._arrived = published + Counter({"captured messages": len(captured.messages)})
        if lost:
            self.missed.update(lost)
            text = ", ".join(f"{count} {name}" for name, count in lost.items())
            yield self.event(Event("WARNING", "missed", f"{self._reader} missed {text}"))
        for message in captured.messages:
            self.now_ns = message.arrived_ns
            yield from self._message(message)

    def _message(self, message: telemetry.CapturedMessage) -> Iterator[Entry]:
        arrived_ns, path, data = message
        kept = b64encode(data).decode("ascii")
        came = {"arrived_ns": arrived_ns, "path": path, "data": kept}
        try:
            control = path == telemetry.CONTROL
            decoded = wire.decode_control(data) if control else wire.decode_frame(data)
        except WireError as error:
            yield self._entry(REFUSED, came | {"cause": error.cause})
            return
        match decoded:
            case wire.Frame(session=session):
                yield self._entry(FRAME, came | _frame_fields(decoded))
                if session == self._session:
                    yield from map(self.event, self._events.arrive(arrived_ns))
            case wire.ClockReply():
                yield self._entry(CLOCK, _clock_fields(decoded, arrived_ns))
            case wire.Welcome(session=session, samples_sent=sent, description=description):
                fields = {"arrived_ns": arrived_ns, "session": session, "samples_sent": sent}
                yield self._entry(STREAM, fields | description.to_wire() | {"data": kept})
                if session != self._session:
                    self._session = session
                    self._events.begin_session()
                    text = f"{description.name!a}, session {session}"
                    yield self.event(Event("INFO", "session", text))
            case wire.Bye(samples_sent=sent):
                self._events.end_stream()
                text = f"{count_text(sent, 'sample')} sent"
                yield self.event(Event("INFO", "end of stream", text))
            case _:  # what only displays send
                yield self._entry(REFUSED, came | {"cause": "unexpected"})

    def _ticks(self, traces: list[telemetry.Trace]) -> Iterator[Entry]:
        """Yield the ticks: fields of the first contactor, and of the others in `others`."""
        for states in zip(
            *(zip(*(c.tolist() for c in t), strict=True) for t in traces), strict=True
        ):
            fields, *others = (_known(_TICK_KEYS, state) for state in states)
            if others:
                keys = ("target_n", "felt_n", "predictor_error_n")
                fields["others"] = [{k: f[k] for k in keys if k in f} for f in others]
            self.now_ns = fields["now_ns"]
            yield self._entry(TICK, fields)

    def _mark(self, mark: Mark) -> Iterator[Entry]:
        before, self.last_mark = self.last_mark, mark
        if before is not None and mark.number > before.number + 1:
            self.missed["marks"] += mark.number - before.number - 1
        if self.started:
            yield self.event(Event("INFO", MARK_EVENT, mark.text), self.now_ns - mark.at_ns)

    def _status(self, status: telemetry.Status) -> Iterator[Entry]:
        playing = [each._asdict() for each in status.playing] or None
        yield self._entry(STATUS, without_none(status._asdict() | {"playing": playing}))
        yield from map(self.event, self._events.take(status.state, status.summary, self.now_ns))
        if status.final:
            self.ended = True
            yield self.event(Event("INFO", "end", "the display has ended"))


# A recording names `full` as its first readers did.
_TICK_KEYS = tuple("scored" if name == "full" else name for name in telemetry.Trace._fields)


def _known(names: Iterable[str], values: Iterable[float]) -> Fields:
    """Return values by name; JSON has no NaN, so fields without a value are left out."""
    return {name: x for name, x in zip(names, values, strict=True) if not math.isnan(x)}


def _frame_fields(frame: wire.Frame) -> Fields:
    """Return the fields of a frame; samples instant by instant, each with all channels.

    Their units are those of the channels. newest_n: of the first channel.
    """
    fields = frame._asdict()
    values = fields.pop("values")
    fields |= {"channels": values.shape[1], "bytes_per_sample": values.itemsize}
    return fields | {"force_n": values.ravel().tolist(), "newest_n": float(values[-1, 0])}


def _clock_fields(reply: wire.ClockReply, t4_ns: int) -> Fields:
    """Return a clock exchange: t1, t4 on the display's clock, t2, t3 on the sensing node's."""
    offset_ms = (reply.t2_ns - reply.t1_ns + reply.t3_ns - t4_ns) / 2 * 1e-6
    round_trip_ms = (t4_ns - reply.t1_ns - (reply.t3_ns - reply.t2_ns)) * 1e-6
    fields = {"t4_ns": t4_ns, "offset_ms": offset_ms, "round_trip_ms": round_trip_ms}
    return reply._asdict() | fields


def without_none(fields: Fields) -> Fields:
    """Return the fields of a status, and of its tables and lists of tables, that have a value."""
    return {name: _valued(value) for name, value in fields.items() if value is not None}


def _valued(value: Any) -> Any:
    if isinstance(value, dict):
        return without_none(value)
    return [_valued(each) for each in value] if isinstance(value, list) else value


class PassiveReceiver:
    """The display's own receiver, fed with the entries of its telemetry or of a recording.

    receiver: its clock, delays and sample counts have the same values as in the display. It sends
    nothing: the clock requests were the display's.
    """

    def __init__(self) -> None:
        # With more than one path, a frame that arrives twice is a copy and not a refusal.
        self.receiver = Receiver("listener", [], LATE_TARGET, paths=2)
        # Each reply is accepted once, as in the display.
        self._requests_ns: deque[int] = deque(maxlen=MAX_OPEN_REQUESTS)

    def take(self, topic: str, fields: Fields) -> wire.Frame | None:
        """Process an entry; return the frame in it, if the display accepted it.

        Raises KeyError, ValueError or TypeError for fields that are not those of an entry.
        """
        if topic == FRAME or (topic == REFUSED and fields["path"] != telemetry.CONTROL):
            receiver, data = self.receiver, b64decode(fields["data"])
            if receiver.on_frame(data, fields["arrived_ns"]) is None or receiver.frame is None:
                return None
            return wire.with_array(receiver.frame)
        if topic in (STREAM, REFUSED):
            self.receiver.on_control(b64decode(fields["data"]), fields["arrived_ns"])
        elif topic == CLOCK:
            session, *times_ns = (fields[key] for key in ("session", "t1_ns", "t2_ns", "t3_ns"))
            reply = wire.ClockReply(session, *times_ns)
            if reply.t1_ns not in self._requests_ns:
                self._requests_ns.append(reply.t1_ns)
                self.receiver.expect_reply(reply.t1_ns)
            self.receiver.on_control(wire.encode_control(reply), fields["t4_ns"])
        return None

    def sampled_ns(self, instant_ns: int) -> int:
        """Return the time of the sample that shows an instant of the pulse.

        It is later by the sensing chain's group delay.
        """
        description = self.receiver.description
        return instant_ns + (0 if description is None else description.group_delay_ns)

    def play(self, instant_ns: int, trusted: bool = False) -> None:
        """Advance the buffer to an instant of the pulse that a tick played.

        trusted: as in `JitterBuffer.advance`.
        """
        if self.receiver.ready:
            self.receiver.buffer.advance(self.sampled_ns(instant_ns), trusted)
