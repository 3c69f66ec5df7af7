"""Telemetry: message formats by which a node publishes its state, for display and recording.

Topics, each a multipart message [topic, msgpack]:

- "trace": every tick since the last trace;
- "status": the running summary, each 0.4 s; the last status has final = true;
- "heard": the captured messages, which are all that the display receives, with their times of
  arrival; published only while a recorder subscribes. Each of this topic states how much was
  published before, so that gaps show;
- "mark": a text at a time (`marks`);
- "~recorder/NAME": nothing. The recorder that a display has started subscribes to it, with a random
  name that no other reader has, so that the display detects when its recorder begins and ends;
- "provenance": versions, host and command of the node, on request (`protocol/provenance.py`).
"""

from collections.abc import Iterator, Sequence
from itertools import accumulate, takewhile
from typing import Annotated, Any, NamedTuple

import msgpack
import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from protocol.config.quantities import Name
from protocol.errors import WireError
from protocol.summary.fields import LARGEST, Summary, read_summary
from protocol.ticks import TickBlock
from protocol.wire.messages import COUNT_RANGE, LARGEST_N, MAX_CHANNELS, MAX_FRAME_BYTES, TIME_RANGE

STATUS = b"status"
MAX_ITEMS = 256


class PlaybackStatus(NamedTuple):
    """Channel and scale by which a contactor of a display plays the stream.

    contactor: its name. channel: number of the played channel. force_ratio: force at the finger
    per force at the wrist that makes both strains equal. strain_per_newton: strain of the layer
    under the finger per force, in 1/N. predictor: its name. stale_after_ns: time without samples
    after which the stream is stale. film_age_ns: age of the felt force at its tick; 0 without a
    real film.
    """

    contactor: Name
    channel: Annotated[int, Field(ge=0, lt=MAX_CHANNELS)]
    force_ratio: Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
    strain_per_newton: Annotated[float, Field(ge=-LARGEST, le=LARGEST)]
    predictor: str
    stale_after_ns: Annotated[int, Field(ge=0, lt=TIME_RANGE.stop)]
    film_age_ns: Annotated[int, Field(ge=0, lt=TIME_RANGE.stop)] = 0


class Status(NamedTuple):
    """Status of a node: its state, stream and running summary.

    session: session of the stream; None while there is none. displays: number of displays of a
    sensing node; None for a display. playing: how each contactor of a display plays the stream;
    empty before it has the stream's description.
    """

    state: str
    stream: str
    summary: dict[str, Any]
    final: bool
    session: int | None = None
    displays: int | None = None
    playing: Sequence[PlaybackStatus] = ()


_PLAYING = TypeAdapter(PlaybackStatus, config=ConfigDict(strict=True, allow_inf_nan=False))


def pack_status(
    state: str,
    stream: str,
    summary: Summary,
    final: bool,
    session: int | None = None,
    displays: int | None = None,
    playing: Sequence[PlaybackStatus] = (),
) -> bytes:
    """Encode a status message, from the fields of `Status`."""
    fields = [state, stream, summary.to_dict(), final, session, displays, playing]
    return bytes(msgpack.packb(fields))


def read_status(data: bytes) -> Status:
    """Decode a status, with every key of a summary. Raises WireError."""
    try:
        state, stream, summary, final, session, displays, playing = unpack(data)
        playing = [_PLAYING.validate_python(PlaybackStatus(*each)) for each in playing]
    except (ValueError, TypeError) as error:
        raise WireError("malformed", f"not a status: {error}") from None
    if not (
        type(state) is type(stream) is str
        and type(summary) is dict
        and type(final) is bool
        and all(number is None or type(number) is int for number in (session, displays))
    ):
        raise WireError("malformed", "a status' field has the wrong type")
    if len({each.contactor for each in playing}) < len(playing):
        raise WireError("malformed", "two contactors of a status have one name")
    try:
        known = read_summary(summary)
    except ValidationError as error:
        raise WireError("malformed", f"a status' summary: {error}") from None
    whole = known.to_dict()
    if not _countable(whole):
        raise WireError("malformed", "a count of a status' summary is out of range")
    if not all(fault.at_ns in TIME_RANGE for fault in known.faults):
        raise WireError("malformed", "the time of a fault is out of range")
    return Status(state, stream, whole, final, session, displays, playing)


def _countable(value: Any) -> bool:
    """Check that every whole number in a summary is one that a float holds exactly."""
    if isinstance(value, dict):
        return all(_countable(inner) for inner in value.values())
    return not isinstance(value, int) or abs(value) in COUNT_RANGE


def unpack(data: bytes, max_items: int = MAX_ITEMS) -> Any:
    """Decode msgpack with at most `max_items` in a container. Raises ValueError or TypeError.

    msgpack allocates as many items as a container's header announces.
    """
    return msgpack.unpackb(data, max_array_len=max_items, max_map_len=max_items)


TRACE = b"trace"
# A status follows each fourth trace. A trace has the ticks of 0.1 s, up to 250 of them, so that
# statuses are 0.4 s apart at ticks of 0.4 ms or more.
STATUS_TRACES = 4


class Trace(NamedTuple):
    """Consecutive ticks of one contactor: arrays of equal length, one value a tick.

    The fields are those of `TickState`. `sensing_now_ns` and E are not sent, since both follow from
    now_ns and the clock's offset: the live page takes the offset of the last status, a report that
    of the captured clock replies. now_ns never falls. press_n and hold_down_n are NaN for any
    contactor but the first one. No number is infinite or beyond `LARGEST_N`.
    """

    now_ns: NDArray[np.int64]
    instant_ns: NDArray[np.int64]
    target_n: NDArray[np.float64]
    felt_n: NDArray[np.float64]
    full: NDArray[np.bool_]
    predictor_error_n: NDArray[np.float64] = np.empty(0)
    trusted: NDArray[np.bool_] = np.empty(0, bool)
    press_n: NDArray[np.float64] = np.empty(0)
    hold_down_n: NDArray[np.float64] = np.empty(0)


class TraceWriter:
    """Collector of blocks of ticks into trace messages."""

    def __init__(self) -> None:
        self._integers: list[bytes] = []
        self._forces: list[bytes] = []
        # Where the finger presses: its press and the hold-down.
        self._press: list[bytes] = []
        self._pressed = False

    @property
    def waiting(self) -> bool:
        """True while there are ticks since the last message."""
        return bool(self._integers)

    def add(self, block: TickBlock) -> None:
        """Add the ticks of a block."""
        ticks = block.columns
        integers = ticks.now_ns, ticks.instant_ns, ticks.full, ticks.trusted
        self._integers.append(np.column_stack(integers).tobytes())
        self._forces.append(block.forces_n.tobytes())
        self._press.append(block.press_n.tobytes())
        self._pressed = self._pressed or not np.isnan(block.press_n).all()

    def rest(self) -> bytes | None:
        """Return a message of the ticks since the last one, if there are any."""
        if not self._integers:
            return None
        columns = [self._integers, self._forces] + [self._press] * self._pressed
        message = [b"".join(parts) for parts in columns]
        self._integers, self._forces, self._press, self._pressed = [], [], [], False
        return bytes(msgpack.packb(message))


def read_trace(data: bytes) -> list[Trace]:
    """Decode a trace message; return the trace of each contactor.

    A felt force or a predictor's error that is infinite or beyond `LARGEST_N` becomes NaN. Raises
    WireError, also for times that fall or are out of range.
    """
    try:
        ints, forces, *rest = unpack(data)
        now_ns, instant_ns, full, trusted = np.frombuffer(ints, "<i8").reshape(-1, 4).T
        values = np.frombuffer(forces, "<f8").reshape(len(now_ns), -1, 3)
        pressed = np.full((len(now_ns), 2), np.nan)
        if rest:
            (press,) = rest
            pressed = np.frombuffer(press, "<f8").reshape(len(now_ns), 2)
    except (ValueError, TypeError) as error:
        raise WireError("malformed", f"not a trace: {error}") from None
    times_ns = np.concatenate([now_ns, instant_ns])
    if np.any((times_ns < TIME_RANGE.start) | (times_ns >= TIME_RANGE.stop)):
        raise WireError("malformed", "a trace's time is out of range")
    if np.any(now_ns[1:] < now_ns[:-1]):
        raise WireError("malformed", "a trace's times fall")
    if not 1 <= values.shape[1] <= MAX_CHANNELS:
        raise WireError("malformed", f"a trace of {values.shape[1]} contactors")
    if not np.all(np.abs(values[..., 0]) <= LARGEST_N):
        raise WireError("malformed", f"a trace's target is not within {LARGEST_N:.0e} N")
    known = np.where(np.abs(values) <= LARGEST_N, values, np.nan)
    flags = full.astype(bool), trusted.astype(bool)
    unpressed = np.full(len(now_ns), np.nan)
    traces = [
        Trace(
            *(now_ns, instant_ns, target_n, felt_n, flags[0], error_n, flags[1]),
            press_n=unpressed,
            hold_down_n=unpressed,
        )
        for target_n, felt_n, error_n in known.transpose(1, 2, 0)
    ]
    press_n, hold_down_n = np.where(np.abs(pressed) <= LARGEST_N, pressed, np.nan).T
    traces[0] = traces[0]._replace(press_n=press_n, hold_down_n=hold_down_n)
    return traces


CAPTURE = b"heard"
# ZeroMQ repeats subscriptions in alphabetical order when it connects again: this one comes last, so
# that a recorder which has subscribed to it has subscribed to all that it reads.
RECORDER = b"~recorder/"
CONTROL = -1
# Overhead of a message beside its bytes.
OVERHEAD_BYTES = 64
# Sockets accept messages of four times a frame's greatest size.
MAX_PART_BYTES = 2 * MAX_FRAME_BYTES
MAX_PART_MESSAGES = MAX_PART_BYTES // OVERHEAD_BYTES + 1
# Most bytes between two traces; further messages of a flood are only counted.
MAX_KEPT_BYTES = 64 * MAX_FRAME_BYTES
SUBSCRIBED, UNSUBSCRIBED = b"\1" + CAPTURE, b"\0" + CAPTURE


class CapturedMessage(NamedTuple):
    """A message received from the sensing node.

    arrived_ns: time of arrival on the display's clock. path: number of the data connection, or
    CONTROL. data: the message, cut above a frame's limit.
    """

    arrived_ns: int
    path: int
    data: bytes


class CapturedMessages(NamedTuple):
    """Consecutive received messages, with their place in the telemetry of a display's run.

    run: random number of the run. now_ns, wall_ns: one instant on the display's clock and in Unix
    time. traces_published, statuses_published: counts so far. before: number of earlier messages.
    """

    run: int
    now_ns: int
    wall_ns: int
    traces_published: int
    statuses_published: int
    before: int
    messages: list[CapturedMessage]


class CaptureWriter:
    """Collector of received messages for recorders, while one subscribes."""

    def __init__(self, run: int) -> None:
        self._run = run
        self._heard = self._first = 0
        self._messages: list[CapturedMessage] = []
        self._kept_bytes = 0
        self._welcome: CapturedMessage | None = None
        self.wanted = False
        self.traces_published = self.statuses_published = 0

    def follow(self, subscription: bytes) -> None:
        """Follow a subscription or cancellation, as an XPUB socket reports it."""
        if subscription == SUBSCRIBED:
            self.wanted = True
            # A recorder that subscribes late needs the stream's description, too.
            if self._welcome is not None:
                self._keep(self._welcome)
        elif subscription == UNSUBSCRIBED:
            self.wanted = False
            self._messages.clear()
            self._kept_bytes = 0

    def add(self, arrived_ns: int, path: int, data: bytes) -> None:
        """Add a received message."""
        if self.wanted and self._kept_bytes < MAX_KEPT_BYTES:
            self._keep(CapturedMessage(arrived_ns, path, data[: MAX_FRAME_BYTES + 1]))
        else:
            self._heard += 1

    def welcome(self, arrived_ns: int, data: bytes) -> None:
        """Store the welcome, which is repeated to recorders that subscribe later."""
        self._welcome = CapturedMessage(arrived_ns, CONTROL, data)

    def take(self, now_ns: int, wall_ns: int) -> Iterator[bytes]:
        """Yield the messages kept since the last call, in one telemetry message or several."""
        kept, self._messages, self._kept_bytes = self._messages, [], 0
        before = self._first if kept else self._heard
        while True:
            # A part holds at least one message, and as many as fit.
            sizes = accumulate(len(message.data) + OVERHEAD_BYTES for message in kept)
            fitting = takewhile(lambda size: size <= MAX_PART_BYTES, sizes)
            part = kept[: max(1, sum(1 for _ in fitting))]
            published = (self.traces_published, self.statuses_published)
            yield msgpack.packb((self._run, now_ns, wall_ns, *published, before, part))
            before += len(part)
            kept = kept[len(part) :]
            if not kept:
                return

    def _keep(self, message: CapturedMessage) -> None:
        if not self._messages:
            self._first = self._heard
        self._heard += 1
        self._kept_bytes += len(message.data) + OVERHEAD_BYTES
        self._messages.append(message)


def read_capture(data: bytes) -> CapturedMessages:
    """Decode a message of received messages. Raises WireError."""
    try:
        *head, messages = unpack(data, MAX_PART_MESSAGES)
        heard = CapturedMessages._make((*head, [CapturedMessage(*message) for message in messages]))
    except (ValueError, TypeError) as error:
        raise WireError("malformed", f"not a capture: {error}") from None
    numbers = [*head, *(number for message in heard.messages for number in message[:2])]
    texts = [message.data for message in heard.messages]
    if not (all(type(n) is int for n in numbers) and all(type(t) is bytes for t in texts)):
        raise WireError("malformed", "a field of a capture has the wrong type")
    if not all(number in TIME_RANGE for number in numbers):
        raise WireError("malformed", "a number of a capture is out of range")
    return heard
