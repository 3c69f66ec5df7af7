"""Many light displays in one process: each receives every frame, requests the clock and reports.

They play nothing.
"""

import math
import time
from array import array
from dataclasses import dataclass
from multiprocessing.connection import Connection

import zmq

from protocol import sockets
from protocol.security.link_keys import ClientKeys
from protocol.wire.messages import (
    ClockRequest,
    DisplayReport,
    Frame,
    Hello,
    Welcome,
    decode_control,
    decode_frame,
    encode_control,
)

SLOT_NS = 1_000_000
REPORT_SLOTS = 1_000
PATIENCE_S = 30.0
# Frames later than this count as lost.
GRACE_S = 2.0
FRAME_WITHIN_S = 60.0


@dataclass(frozen=True, slots=True)
class DisplayTimings:
    """Delay of each copy of a frame from its last sample's instant, and missing copies."""

    delays_ns: "array[int]"
    lost: int


class ManyDisplays:
    """`count` displays at one address, which request the clock every `clock_ms`, or never (0).

    One XSUB keeps a connection for each of them, so that one queue is read.
    """

    def __init__(
        self, address: str, count: int, clock_ms: int, keys: ClientKeys | None = None
    ) -> None:
        self._context: sockets.Context = zmq.Context()
        self._count = count
        self._clock_slots = clock_ms
        self._data = sockets.unconnected(self._context, zmq.XSUB, keys)
        for _ in range(count):
            self._data.connect(address)
        self._controls = [
            sockets.connect(self._context, zmq.DEALER, sockets.control_address(address), keys)
            for _ in range(count)
        ]
        self._session = 0
        self._slot = 0
        self._frames: dict[bytes, tuple[Frame, int, array[int]]] = {}

    def join(self) -> None:
        """Send hello, and receive until every display has the stream. Raises TimeoutError."""
        end_s = time.monotonic() + PATIENCE_S
        for number, control in enumerate(self._controls):
            control.send(encode_control(Hello(f"{id(self)}-{number}")))
        for control in self._controls:
            if not control.poll(round(PATIENCE_S * 1000)):
                raise TimeoutError("a display was not welcomed")
            welcome = decode_control(control.recv())
            assert isinstance(welcome, Welcome)
            self._session = welcome.session
        self._data.send(b"\1")
        while not any(len(arrivals) == self._count for _, _, arrivals in self._frames.values()):
            if time.monotonic() > end_s:
                raise TimeoutError("not every display receives the stream")
            self.live(50 * SLOT_NS)

    def listen(self, seconds: float) -> DisplayTimings:
        """Return the timings of frames whose first sample is within the next `seconds`."""
        self._frames.clear()
        begin_ns = time.perf_counter_ns()
        self.live(round((seconds + GRACE_S) * 1e9))
        end_ns = begin_ns + round(seconds * 1e9)
        measured = [
            (frame, arrivals)
            for frame, _, arrivals in self._frames.values()
            if begin_ns <= frame.t_first_ns < end_ns
        ]
        measured.sort(key=lambda each: each[0].first_sample)
        delays_ns: array[int] = array("q")
        lost = 0
        next_sample = measured[0][0].first_sample
        for frame, arrivals in measured:
            # Frames that reached no display are counted by the gap in the sample numbers.
            lost += math.ceil((frame.first_sample - next_sample) / len(frame.values)) * self._count
            lost += self._count - len(arrivals)
            next_sample = frame.first_sample + len(frame.values)
            delays_ns.extend(arrivals)
        return DisplayTimings(delays_ns, lost)

    def await_frame(self) -> float:
        """Return the time in s until a frame arrives. Raises TimeoutError."""
        self._frames.clear()
        began_s = time.monotonic()
        while not self._frames:
            if time.monotonic() > began_s + FRAME_WITHIN_S:
                raise TimeoutError("no frame comes")
            self.live(SLOT_NS)
        return time.monotonic() - began_s

    def close(self) -> None:
        """Close the sockets."""
        self._context.destroy(linger=0)

    def live(self, duration_ns: int) -> None:
        """Receive and request for `duration_ns`."""
        end_ns = time.perf_counter_ns() + duration_ns
        descriptors = sockets.descriptors([self._data])
        while (now_ns := time.perf_counter_ns()) < end_ns:
            self._ask(now_ns)
            self._receive_all()
            sockets.wait_on_descriptors(descriptors, SLOT_NS)

    def _receive_all(self) -> None:
        frames, receive = self._frames, self._data.recv
        while True:
            try:
                data = receive(zmq.NOBLOCK)
            except zmq.Again:
                return
            # A frame is decoded once; its other copies are recognised by their bytes.
            known = frames.get(data)
            if known is None:
                frame = decode_frame(data)
                last_ns = frame.t_first_ns + (len(frame.values) - 1) * frame.period_ns
                known = frames[data] = frame, last_ns, array("q")
            known[2].append(time.perf_counter_ns() - known[1])

    def _ask(self, now_ns: int) -> None:
        """Send the requests of each slot."""
        slot = now_ns // SLOT_NS
        for passed in range(max(self._slot + 1, slot - REPORT_SLOTS), slot + 1):
            if self._clock_slots:
                for control in self._controls[passed % self._clock_slots :: self._clock_slots]:
                    self._drain(control)
                    sockets.send(control, encode_control(ClockRequest(now_ns)))
            for number in range(passed % REPORT_SLOTS, self._count, REPORT_SLOTS):
                report = DisplayReport(
                    self._session, f"{id(self)}-{number}", 1, 0, 0, 0, 1.0, 1.0, 1.0, 0.1
                )
                sockets.send(self._controls[number], encode_control(report))
        self._slot = slot

    def _drain(self, control: sockets.Socket) -> None:
        for _ in sockets.receive_parts(control):
            pass


def run_many_displays(
    address: str, count: int, clock_ms: int, keys: ClientKeys | None, parent: Connection
) -> None:
    """Join and report it; receive for the seconds that the parent sends, and return the timings."""
    displays = ManyDisplays(address, count, clock_ms, keys)
    try:
        displays.join()
        parent.send(None)
        parent.send(displays.listen(parent.recv()))
    finally:
        displays.close()
