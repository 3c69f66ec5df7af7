"""Clock error added by relays in a row: all nodes share a clock, so its offset is 0."""

import itertools
import time
from contextlib import ExitStack

import numpy as np
import zmq

from benchmarks.benchmark import Benchmark
from benchmarks.load.run import relay
from benchmarks.load.sensing import Stream, sense
from benchmarks.timing import process
from protocol import sockets
from protocol.clock.estimator import ClockEstimator, ClockExchange
from protocol.wire.messages import ClockReply, ClockRequest, decode_control, encode_control
from telepulse.processes import free_addresses

EXCHANGES = 250
EVERY_S = 0.02
RELAYS = (0, 1, 2, 3)
PATIENCE_MS = 20_000


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    rows = []
    for relays in RELAYS:
        exchanges = ask(relays)
        clock = ClockEstimator()
        for exchange in exchanges:
            clock.add(exchange)
        now_ns = exchanges[-1].t4_ns
        round_trip_ms = [exchange.round_trip_ns * 1e-6 for exchange in exchanges]
        rows.append(
            (
                str(relays),
                *(f"{value:.2f}" for value in np.quantile(round_trip_ms, (0.5, 0.99))),
                f"{clock.offset_ns(now_ns) * 1e-3:+.0f}",
                f"{clock.uncertainty_ns(now_ns) * 1e-3:.0f}",
            )
        )
    benchmark.table(
        f"The clock through relays in a row, after {EXCHANGES} exchanges",
        ("relays", "round trip p50 ms", "p99 ms", "offset error µs", "stated ± µs"),
        rows,
    )


def ask(relays: int) -> list[ClockExchange]:
    """Return exchanges through a row of relays."""
    addresses = free_addresses(1 + relays)
    with ExitStack() as stack:
        stack.enter_context(process(sense, Stream(batch=5), addresses[0]))
        for near, far in itertools.pairwise(addresses):
            stack.enter_context(process(relay, near, far))
        context: sockets.Context = stack.enter_context(zmq.Context())
        control = sockets.connect(context, zmq.DEALER, sockets.control_address(addresses[-1]))
        stack.callback(control.close, 0)
        control.setsockopt(zmq.RCVTIMEO, PATIENCE_MS)
        exchanges = [exchange(control) for _ in range(EXCHANGES)]
    # The first one includes the time of all connections.
    return exchanges[1:]


def exchange(control: sockets.Socket) -> ClockExchange:
    """Send one request, and return the answer's four time stamps."""
    t1_ns = time.perf_counter_ns()
    control.send(encode_control(ClockRequest(t1_ns)))
    reply = decode_control(control.recv())
    t4_ns = time.perf_counter_ns()
    assert isinstance(reply, ClockReply)
    time.sleep(EVERY_S)
    return ClockExchange(t1_ns, reply.t2_ns, reply.t3_ns, t4_ns)
