"""Telemetry: what the real-time loop tells the world, for another process to show or record.

Two topics, each a multipart message [topic, msgpack]: "trace" holds every tick since the last
one; "status" holds the running summary. A last status has final = true. A third topic is for
recorders (`heard.py`).

Age of a display's last status, by the time stamps of its telemetry. Pure.
"""

from typing import NamedTuple

import msgpack
import numpy as np
from numpy.typing import NDArray

from display_node.display import Display, TickState
from protocol.errors import WireError
from protocol.run_summary import Summary
from protocol.wire.messages import LARGEST_N, TIME_RANGE
from protocol.wire.status import STATUS, Status, pack_status, read_status, unpack

# Of how long ago the shortest transit is used: two clocks drift by some 50 µs/s against each other.
WINDOW_NS = 60_000_000_000
# A display on this machine stamps by this machine's clock, unless the address leads through a
# tunnel. Telemetry that seems to be older than this, or of the future, has another clock.
LONGEST_QUEUED_NS = 10_000_000_000
# Traces further apart have a stall between them, or the start of another process.
BREAK_NS = 500_000_000


class TelemetryAge:
    """Age of the newest status of one display, as of the last time when it held.

    Telemetry may have queued while its reader or its display stood still, so its age counts from
    the display's stamp and not from its receipt. A status has no stamp: it follows a trace of the
    same tick, and holds until the newest of the traces that follow without a break. The clock of
    another machine has an unknown offset: there, the age counts from the earliest receipt that the
    shortest transit of the last one to two minutes allows.
    """

    def __init__(self, local: bool = False) -> None:
        """local: the display's address is on this machine."""
        self._local = local
        # The newest trace, and the one until which the newest status holds.
        self._stamped_ns: int | None = None
        self._status_ns: int | None = None
        # Least difference of receipt and stamp, in the present window and in the one before.
        self._least_ns: int | None = None
        self._before_ns: int | None = None
        self._window_ends_ns = 0
        # Of a status before the first trace.
        self._received_ns: int | None = None

    def take_trace(self, stamped_ns: int, received_ns: int) -> None:
        """Take a trace whose newest tick is stamped `stamped_ns`, received at `received_ns`."""
        if self._stamped_ns is not None and stamped_ns < self._stamped_ns:
            # Another clock: its machine was started again.
            self._least_ns = self._before_ns = self._status_ns = None
        elif (
            self._status_ns == self._stamped_ns is not None
            and stamped_ns - self._stamped_ns <= BREAK_NS
        ):
            self._status_ns = stamped_ns
        self._stamped_ns = stamped_ns
        difference_ns = received_ns - stamped_ns
        if received_ns >= self._window_ends_ns:
            self._window_ends_ns = received_ns + WINDOW_NS
            self._before_ns, self._least_ns = self._least_ns, difference_ns
        elif self._least_ns is None or difference_ns < self._least_ns:
            self._least_ns = difference_ns

    def take_status(self, received_ns: int) -> None:
        """Take a status, received at `received_ns`."""
        self._status_ns, self._received_ns = self._stamped_ns, received_ns

    def age_ns(self, now_ns: int) -> int | None:
        """Return the age of the newest status at `now_ns` in ns; None before the first one."""
        if self._received_ns is None:
            return None
        if self._status_ns is None:
            return max(0, now_ns - self._received_ns)
        return max(0, now_ns - self._status_ns - self._offset_ns())

    def _offset_ns(self) -> int:
        """Return this clock less the display's, with the shortest transit where it is another."""
        known = [least for least in (self._least_ns, self._before_ns) if least is not None]
        least_ns = min(known, default=0)
        same = self._local and 0 <= least_ns <= LONGEST_QUEUED_NS
        return 0 if same else least_ns


__all__ = [
    "STATUS",
    "STATUS_TRACES",
    "TRACE",
    "TRACE_TICKS",
    "Status",
    "Trace",
    "TraceWriter",
    "read_status",
    "read_trace",
    "unpack",
    "write_status",
]

TRACE = b"trace"
TRACE_TICKS = 20
STATUS_TRACES = 10


class Trace(NamedTuple):
    """Consecutive ticks: arrays of equal length, one value a tick.

    now_ns on the display's clock, never falling; instant_ns on the sensing clock; target force in
    N; felt_n: felt force in N, NaN where it is unknown (no reading of the film); scored: whether
    the pulse was being felt at its full strength; predictor_error_n: RMSE that the predictor
    expects, NaN where it did not stand in or cannot tell; trusted: whether it is trusted with all
    of the delay. No number is infinite or beyond `LARGEST_N`.
    """

    now_ns: NDArray[np.int64]
    instant_ns: NDArray[np.int64]
    target_n: NDArray[np.float64]
    felt_n: NDArray[np.float64]
    scored: NDArray[np.bool_]
    predictor_error_n: NDArray[np.float64] = np.empty(0)
    trusted: NDArray[np.bool_] = np.empty(0, bool)


class TraceWriter:
    """Collects ticks and gives them out as messages."""

    def __init__(self) -> None:
        self._ints: list[int] = []
        self._forces: list[float] = []

    def add(self, felt: TickState) -> bytes | None:
        """A tick; a trace message when one is full."""
        ints = self._ints
        ints += (felt.now_ns, felt.instant_ns, felt.scored, felt.trusted)
        self._forces += (felt.target_n, felt.felt_n, felt.predictor_error_n)
        return self.rest() if len(ints) >= 4 * TRACE_TICKS else None

    def rest(self) -> bytes | None:
        """The ticks since the last message as one, if there are any."""
        if not self._ints:
            return None
        message = [np.array(self._ints, "<i8").tobytes(), np.array(self._forces, "<f8").tobytes()]
        self._ints, self._forces = [], []
        return bytes(msgpack.packb(message))


def read_trace(data: bytes) -> Trace:
    """Decode a trace message.

    A felt force or a predictor's error that is infinite or beyond `LARGEST_N` is no measurement
    and becomes NaN. Raises WireError, also for times that fall or are out of range.
    """
    try:
        ints, forces = unpack(data)
        now_ns, instant_ns, scored, trusted = np.frombuffer(ints, "<i8").reshape(-1, 4).T
        target_n, felt_n, error_n = np.frombuffer(forces, "<f8").reshape(len(now_ns), 3).T
    except (ValueError, TypeError) as error:
        raise WireError("malformed", f"not a trace: {error}") from None
    times_ns = np.concatenate([now_ns, instant_ns])
    if np.any((times_ns < TIME_RANGE.start) | (times_ns >= TIME_RANGE.stop)):
        raise WireError("malformed", "a trace's time is out of range")
    if np.any(now_ns[1:] < now_ns[:-1]):
        raise WireError("malformed", "a trace's times fall")
    if not np.all(np.abs(target_n) <= LARGEST_N):
        raise WireError("malformed", f"a trace's target is not within {LARGEST_N:.0e} N")
    flags = scored.astype(bool), trusted.astype(bool)
    known_n, error_n = (np.where(np.abs(x) <= LARGEST_N, x, np.nan) for x in (felt_n, error_n))
    return Trace(now_ns, instant_ns, target_n, known_n, flags[0], error_n, flags[1])


def write_status(display: Display, summary: Summary, final: bool) -> bytes:
    """A display's status message."""
    receiver = display.receiver
    stream = receiver.description.name if receiver.description else ""
    session, playing = receiver.session, display.playing
    return pack_status(display.state, stream, summary, final, session, playing=playing)
