"""Forwarding of a display's telemetry to LSL; what cannot be forwarded is counted."""

import logging
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np

from protocol.wire.messages import Frame
from telepulse.lsl_outlet.streams import LslStreams
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.passive_receiver import PassiveReceiver
from telepulse.telemetry.schema import EVENT, FRAME, TICK

logger = logging.getLogger(__name__)

# Longer than a link that reorders delays a frame; later ones count as lost.
HOLD_NS = 500_000_000


class FrameReorderer:
    """Buffer that holds a frame back while an earlier one may still arrive.

    Attributes
    ----------
    lost : int
        Samples that did not arrive in time.
    """

    def __init__(self) -> None:
        self._held: dict[int, tuple[int, Frame]] = {}
        self._next_sample: int | None = None
        self.lost = 0

    def take(self, frame: Frame, now_ns: int) -> Iterator[Frame]:
        """Add a frame; yield the frames whose turn it is."""
        if self._next_sample is None:
            self._next_sample = frame.first_sample
        if frame.first_sample >= self._next_sample:
            self._held[frame.first_sample] = (now_ns, frame)
        while self._held:
            first = min(self._held)
            if first > self._next_sample and now_ns - self._held[first][0] < HOLD_NS:
                return
            yield self._release(first)

    def flush(self) -> Iterator[Frame]:
        """Yield the frames that are still held."""
        while self._held:
            yield self._release(min(self._held))

    def _release(self, first: int) -> Frame:
        _, frame = self._held.pop(first)
        self.lost += first - (self._next_sample or 0)
        self._next_sample = first + len(frame.values)
        return frame


TRIES = 9


class LslTime:
    """Mapping of Unix times of one run of a display to LSL's local clock, in s.

    Its error is the difference between the clocks of this host and the display's host.
    """

    def __init__(self, local_clock: Callable[[], float]) -> None:
        self._local_clock = local_clock
        self.begin()

    def begin(self) -> None:
        """Compare both clocks, when a run of the display begins."""
        self._unix_ns, self._lsl_s, _ = min(
            (self._compare() for _ in range(TRIES)), key=lambda reading: reading[2]
        )

    def at(self, unix_ns: int) -> float:
        """Return LSL's time of a Unix time, in s."""
        return self._lsl_s + (unix_ns - self._unix_ns) * 1e-9

    def _compare(self) -> tuple[int, float, float]:
        """Return one instant on both clocks, and how long it took to read them."""
        before_s = self._local_clock()
        unix_ns = time.time_ns()
        after_s = self._local_clock()
        return unix_ns, (before_s + after_s) / 2, after_s - before_s


class LslForwarder:
    """Forwarder of one display.

    Attributes
    ----------
    passed : Counter
        Samples of the wrist, ticks and events passed to LSL.
    """

    def __init__(self, outlets: LslStreams) -> None:
        self._outlets = outlets
        self._time = LslTime(outlets.local_clock)
        self._receiver = PassiveReceiver()
        self._session: int | None = None
        self._reorderer = FrameReorderer()
        self._lost = 0
        self.passed: Counter[str] = Counter()

    @property
    def lost(self) -> int:
        """Number of samples of the wrist that did not arrive in time."""
        return self._lost + self._reorderer.lost

    def take(self, entries: list[Entry]) -> None:
        """Forward the entries of one telemetry message."""
        ticks = [entry for entry in entries if entry.topic == TICK]
        if ticks:
            self._take_ticks(ticks)
        for entry in entries:
            if entry.topic == EVENT:
                self._take_event(entry)
            elif entry.topic != TICK:
                frame = self._receiver.take(entry.topic, entry.fields)
                if frame is not None:
                    self._take_frame(frame, entry)
                elif entry.topic == FRAME and not self._receiver.clock.ready:
                    self.passed["frames too early"] += 1

    def finish(self) -> None:
        """Forward the frames that are held back."""
        for frame in self._reorderer.flush():
            self._push(frame)
        self._lost, self._reorderer = self.lost, FrameReorderer()

    def _take_frame(self, frame: Frame, entry: Entry) -> None:
        if frame.session != self._session:
            self._begin(frame.session)
        arrived_ns = entry.fields["arrived_ns"]
        # From the sensing clock to the display's, and to Unix time.
        ahead_ns = self._receiver.clock.offset_ns(arrived_ns) + arrived_ns - entry.t_ns
        in_unix_time = frame._replace(t_first_ns=frame.t_first_ns - ahead_ns)
        for each in self._reorderer.take(in_unix_time, arrived_ns):
            self._push(each)

    def _begin(self, session: int) -> None:
        self.finish()
        self._session = session
        description = self._receiver.description
        assert description is not None
        verb = "begins" if self._outlets.describe(description) else "continues"
        logger.info(f"{description.name!a} {verb}: session {session}")

    def _push(self, frame: Frame) -> None:
        count = len(frame.values)
        times_s = [self._time.at(frame.t_first_ns + at * frame.period_ns) for at in range(count)]
        self._outlets.push_wrist(np.ascontiguousarray(frame.values), times_s)
        self.passed["samples"] += count

    def _take_ticks(self, ticks: list[Entry]) -> None:
        # Where the force felt is unknown, LSL gets a NaN.
        forces_n = [
            (entry.fields["target_n"], entry.fields.get("felt_n", math.nan)) for entry in ticks
        ]
        self._outlets.push_finger(forces_n, [self._time.at(entry.t_ns) for entry in ticks])
        self._receiver.play(ticks[-1].fields["instant_ns"])
        self.passed["ticks"] += len(ticks)

    def _take_event(self, entry: Entry) -> None:
        name = entry.fields["name"]
        if name == "begin":
            # A display that was restarted has another clock.
            self.finish()
            self._time.begin()
            self._receiver, self._session = PassiveReceiver(), None
        self._outlets.push_event(f"{name}: {entry.fields['message']}", self._time.at(entry.t_ns))
        self.passed["events"] += 1
