"""One run of one peer: a publisher's process, a subscriber's, and the arrivals."""

import time
from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.message import Arrival, Wire
from benchmarks.timing import paced, process, spawn
from telepulse.processes import free_addresses
from tests.support.hostile_peers import port_of
from tests.support.keyring import Keyring

PERIOD_NS = 1_000_000
# Connecting, and the first messages of a process, are not measured.
WARM_UP = 300
PATIENCE_S = 30.0


Publish = Callable[[Wire, Iterable[int]], None]
Subscribe = Callable[[Wire], Iterator[Arrival]]


@dataclass(frozen=True, slots=True)
class Run:
    """Results of a subscriber.

    Delays in ns, messages missing and out of order, its CPU time in ns. delays_ns: until a value
    can be used. done_ns: until its subscriber has finished with it. CPU time is of all its
    threads, from the end of the warm-up to the last message.
    """

    delays_ns: NDArray[np.int64]
    done_ns: NDArray[np.int64]
    lost: int
    disordered: int
    cpu_ns: int


def run(publish: Publish, subscribe: Subscribe, curve: bool, messages: int) -> Run:
    """Run a peer by its module-level functions. Raises RuntimeError when nothing arrives."""
    name, port = subscribe.__name__, port_of(free_addresses(1)[0])
    ours, theirs = spawn.Pipe(duplex=False)
    with TemporaryDirectory(prefix="telepulse-") as folder:
        wire = Wire(port, Keyring(Path(folder)) if curve else None)
        with (
            process(_publish, publish, wire),
            process(_subscribe, subscribe, wire, messages, theirs),
        ):
            theirs.close()
            if not ours.poll(PATIENCE_S + messages * PERIOD_NS * 1e-9):
                raise RuntimeError(f"{name}: no figures within {PATIENCE_S:g} s of their time")
            try:
                received: Run = ours.recv()
            except EOFError:
                raise RuntimeError(f"{name} ended without figures") from None
            return received


def _publish(publish: Publish, wire: Wire) -> None:
    """Send a message every millisecond until terminated."""
    publish(wire, (number for number, _ in enumerate(paced(PERIOD_NS))))


def _subscribe(subscribe: Subscribe, wire: Wire, messages: int, result: Connection) -> None:
    """Receive the warm-up and then so many messages, and return the figures."""
    result.send(measure(subscribe(wire), messages))


def measure(arrivals: Iterator[Arrival], messages: int) -> Run:
    """Return the figures of `messages` arrivals after the warm-up."""
    for _ in range(WARM_UP):
        newest = next(arrivals).sequence
    delays_ns, done_ns, lost, disordered = array("q"), array("q"), 0, 0
    began_ns = time.process_time_ns()
    for _ in range(messages):
        sequence, sent_ns, usable_ns = next(arrivals)
        done_ns.append(time.perf_counter_ns() - sent_ns)
        delays_ns.append(usable_ns - sent_ns)
        if sequence > newest:
            lost += sequence - newest - 1
            newest = sequence
        else:
            disordered += 1
    cpu_ns = time.process_time_ns() - began_ns
    return Run(np.array(delays_ns), np.array(done_ns), lost, disordered, cpu_ns)
