"""What a display's finger feels, heard from its telemetry while things go wrong."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import zmq

from protocol.wire.telemetry import STATUS, TRACE, Status, Trace, read_status, read_trace

POLL_MS = 20
# What is heard of a tick comes with the rest of its trace, 20 ms later at most.
LOOK_AGAIN_S = 0.01
STEADY_S = 0.3


class Finger:
    """All traces of a display, and its last status; through restarts, where the address stays."""

    def __init__(self) -> None:
        self._traces: list[Trace] = []
        self.status: Status | None = None
        self.over = threading.Event()

    def listen(self, address: str) -> None:
        """Hear telemetry until it is over."""
        with zmq.Context() as context, context.socket(zmq.SUB) as socket:
            socket.setsockopt(zmq.LINGER, 0)
            socket.subscribe(b"")
            socket.connect(address)
            while not self.over.is_set():
                if socket.poll(POLL_MS):
                    topic, data = socket.recv_multipart()
                    if topic == TRACE:
                        self._traces.append(read_trace(data))
                    elif topic == STATUS:
                        self.status = read_status(data)

    def felt_from_ns(self, since_ns: int, within_s: float) -> int | None:
        """The first instant from `since_ns` on at which the pulse was felt at full strength, on
        the display's clock; None where it was not within so long.
        """
        return self._first_ns(since_ns, within_s, felt=True)

    def felt_steadily_from_ns(self, since_ns: int, within_s: float) -> int | None:
        """As `felt_from_ns`, but felt for a while from then on."""
        felt_ns: int | None = since_ns
        while felt_ns is not None:
            felt_ns = self.felt_from_ns(felt_ns, within_s)
            if felt_ns is None:
                return None
            unfelt_ns = self.unfelt_from_ns(felt_ns, STEADY_S)
            if unfelt_ns is None or unfelt_ns > felt_ns + STEADY_S * 1e9:
                return felt_ns
            felt_ns = unfelt_ns
        return None

    def unfelt_from_ns(self, since_ns: int, within_s: float) -> int | None:
        """The first instant from `since_ns` on at which it was not."""
        return self._first_ns(since_ns, within_s, felt=False)

    def _first_ns(self, since_ns: int, within_s: float, felt: bool) -> int | None:
        # The display's clock may be another than ours.
        until_s = time.monotonic() + within_s
        number = 0
        while True:
            late = time.monotonic() > until_s
            while number < len(self._traces):
                trace = self._traces[number]
                wanted = np.flatnonzero((trace.now_ns >= since_ns) & (trace.scored == felt))
                if len(wanted):
                    return int(trace.now_ns[wanted[0]])
                number += 1
            if late:
                return None
            time.sleep(LOOK_AGAIN_S)

    def felt_share(self, from_ns: int, to_ns: int) -> float:
        """Of the ticks in between, the share at which the pulse was felt at full strength."""
        trace = self.trace()
        ticks = (from_ns <= trace.now_ns) & (trace.now_ns <= to_ns)
        return float(trace.scored[ticks].mean())

    def peaks(self) -> tuple[float, float, float]:
        """The most that was felt, in N; how fast what was wanted of the actuator changed at most,
        and how fast what was felt did, in N/s.
        """
        trace = self.trace()
        seconds = np.diff(trace.now_ns) * 1e-9
        wanted, felt = (np.abs(np.diff(n)) / seconds for n in (trace.target_n, trace.felt_n))
        return float(trace.felt_n.max()), float(wanted.max()), float(felt.max())

    def trace(self) -> Trace:
        """All ticks so far as one trace."""
        columns = zip(*self._traces, strict=True)
        return Trace(*(np.concatenate(column) for column in columns))


@contextmanager
def finger_of(address: str) -> Iterator[Finger]:
    """The finger of the display that publishes telemetry at `address`, within a `with`."""
    finger = Finger()
    listener = threading.Thread(target=finger.listen, args=(address,))
    listener.start()
    try:
        yield finger
    finally:
        finger.over.set()
        listener.join()
