"""The force felt at a display while faults are made, recorded from its telemetry."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import zmq

from protocol.wire.telemetry import STATUS, TRACE, Status, Trace, read_status, read_trace
from tests.support.waiting import polled

POLL_MS = 20
# A trace covers 20 ms of ticks, and arrives at its end.
LOOK_AGAIN_S = 0.01
STEADY_S = 0.3
# The requirement. A display on a busy machine may exceed it: of `TRIES` faults of one kind one must
# meet it, and all must be over within `PATIENCE_S`.
BACK_WITHIN_S = 1.0
TRIES = 5
PATIENCE_S = 20.0
FORCE_LIMIT_N = 2.5
# Below the pulse's height of every shipped scene, above which the pulse was felt.
LEAST_PEAK_N = 0.15
# Of the scene, and what floating point adds to it.
SLEW_LIMIT_N_PER_S = 50.0 + 1e-6


class FeltForce:
    """All traces of a display and its last status, across restarts at the same address.

    Whether the pulse is felt holds for all contactors of a display at once.
    """

    def __init__(self) -> None:
        # The traces of each contactor, by message.
        self.traces: list[list[Trace]] = []
        self.status: Status | None = None
        # All statuses, and when each arrived.
        self.statuses: list[tuple[int, Status]] = []

    def receive(self, socket: "zmq.Socket[bytes]") -> None:
        """Receive a message of telemetry, if one comes soon."""
        if socket.poll(POLL_MS):
            topic, data = socket.recv_multipart()
            if topic == TRACE:
                self.add(read_trace(data))
            elif topic == STATUS:
                self.status = read_status(data)
                self.statuses.append((time.perf_counter_ns(), self.status))

    def add(self, traces: list[Trace]) -> None:
        """Add the ticks of a message, a trace for each contactor."""
        self.traces.append(traces)

    def first_ns(self, since_ns: int, within_s: float, felt: bool = True) -> int | None:
        """Return when the pulse was first felt at full strength, or not felt, from `since_ns` on.

        The time is on the display's clock; None if it did not happen within `within_s`.
        """
        # The display's clock may differ from this process's.
        until_s = time.monotonic() + within_s
        number = 0
        while True:
            late = time.monotonic() > until_s
            while number < len(self.traces):
                trace = self.traces[number][0]
                wanted = np.flatnonzero((trace.now_ns >= since_ns) & (trace.full == felt))
                if len(wanted):
                    return int(trace.now_ns[wanted[0]])
                number += 1
            if late:
                return None
            time.sleep(LOOK_AGAIN_S)

    def steady_from_ns(self, since_ns: int, within_s: float) -> int | None:
        """Return the first time from which the pulse was felt for `STEADY_S` without a gap."""
        felt_ns: int | None = since_ns
        while felt_ns is not None:
            felt_ns = self.first_ns(felt_ns, within_s)
            if felt_ns is None:
                return None
            unfelt_ns = self.first_ns(felt_ns, STEADY_S, felt=False)
            if unfelt_ns is None or unfelt_ns > felt_ns + STEADY_S * 1e9:
                return felt_ns
            felt_ns = unfelt_ns
        return None

    def share(self, from_ns: int, to_ns: int) -> float:
        """Return the share of ticks between two times at which the pulse was fully felt."""
        trace = self.trace()
        ticks = (from_ns <= trace.now_ns) & (trace.now_ns <= to_ns)
        return float(trace.full[ticks].mean())

    def peaks(self) -> tuple[float, float, float]:
        """Return the greatest felt force in N, and the greatest slew of target and felt in N/s.

        Each is the greatest of any contactor.
        """
        force_n, target_n_per_s, felt_n_per_s = map(max, zip(*self.all_peaks(), strict=True))
        return force_n, target_n_per_s, felt_n_per_s

    def all_peaks(self) -> list[tuple[float, float, float]]:
        """Return the peaks of each contactor."""
        peaks = []
        for contactor in range(len(self.traces[0])):
            trace = self.trace(contactor)
            seconds = np.diff(trace.now_ns) * 1e-9
            target, felt = (np.abs(np.diff(n)) / seconds for n in (trace.target_n, trace.felt_n))
            peaks.append((float(trace.felt_n.max()), float(target.max()), float(felt.max())))
        return peaks

    def trace(self, contactor: int = 0) -> Trace:
        """Return all ticks of a contactor so far as one trace."""
        columns = zip(*(traces[contactor] for traces in self.traces), strict=True)
        return Trace(*(np.concatenate(column) for column in columns))


@contextmanager
def recording(address: str) -> Iterator[FeltForce]:
    """Record the display that publishes telemetry at `address`."""
    felt = FeltForce()
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.subscribe(b"")
        socket.connect(address)
        with polled(lambda: felt.receive(socket)):
            yield felt


def assert_back_within_a_second(
    felt: FeltForce, fault: Callable[[], int], within_s: float = BACK_WITHIN_S
) -> None:
    """Make a fault, which returns the time of its end in ns; the pulse is felt soon after.

    within_s: another limit than a second.
    """
    delays_s: list[float] = []
    while not delays_s or delays_s[-1] > within_s:
        assert len(delays_s) < TRIES, f"felt again only {delays_s} s after the fault's end"
        ended_ns = fault()
        felt_ns = felt.steady_from_ns(ended_ns, PATIENCE_S)
        assert felt_ns is not None
        delays_s.append((felt_ns - ended_ns) * 1e-9)


def assert_limits_kept(felt: FeltForce) -> None:
    """Neither force nor slew exceeded the scene's limits, from the first tick to the last."""
    for force_n, target_n_per_s, _ in felt.all_peaks():
        # The stall guard reduces the force while a host stalls (`StallGuard`).
        assert LEAST_PEAK_N < force_n <= FORCE_LIMIT_N
        assert target_n_per_s <= SLEW_LIMIT_N_PER_S
