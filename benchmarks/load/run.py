"""One run: a sensing node, relays, groups of many displays, and the cost of each of them."""

import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.load.many_displays import DisplayTimings, run_many_displays
from benchmarks.load.sensing import Stream, sense
from benchmarks.timing import process, spawn, thread_times_s
from protocol.host.process import stop_on_signals
from telepulse.processes import free_addresses
from telepulse.relay import Relay
from tests.support.keyring import Keyring

SECONDS = 5.0
PATIENCE_S = 60.0


@dataclass(frozen=True, slots=True)
class Load:
    """The parts of a run.

    displays, relays: their numbers. clock_ms: interval of the displays' clock requests; 0: never.
    stream: stream of the sensing node. keys: the link has keys.
    """

    displays: int
    clock_ms: int = 50
    relays: int = 0
    stream: Stream = field(default_factory=Stream)
    keys: bool = False


@dataclass(frozen=True, slots=True)
class Figures:
    """Results of a run.

    One-way delays in ms, frames lost, and CPU in shares of one core: of the sensing node's loop and
    of its ZeroMQ, of all relays, of all displays.
    """

    p50_ms: float
    p99_ms: float
    lost: int
    loop: float
    zeromq: float
    relays: float
    displays: float

    @property
    def sensing(self) -> float:
        """Return the CPU of the sensing node, in shares of one core."""
        return self.loop + self.zeromq


def run(load: Load) -> Figures:
    """Run for `SECONDS`. Raises RuntimeError when a display cannot join."""
    addresses = free_addresses(1 + load.relays)
    with ExitStack() as processes:
        server = client = None
        if load.keys:
            keys = Keyring(Path(processes.enter_context(TemporaryDirectory(prefix="telepulse-"))))
            keys.allow("finger")
            server, client = keys.server(), keys.client("finger")
        sensing = processes.enter_context(process(sense, load.stream, addresses[0], server))
        relays = [
            processes.enter_context(process(relay, addresses[0], address))
            for address in addresses[1:]
        ]
        displays, pipes = [], []
        listening = addresses[1:] or addresses
        for number, address in enumerate(listening):
            count = len(range(number, load.displays, len(listening)))
            ours, theirs = spawn.Pipe()
            arguments = address, count, load.clock_ms, client, theirs
            displays.append(processes.enter_context(process(run_many_displays, *arguments)))
            theirs.close()
            pipes.append(ours)
        for pipe in pipes:
            receive(pipe)
        for pipe in pipes:
            pipe.send(SECONDS)
        groups = [sensing], relays, displays
        before, began_s = [cpu_s(group) for group in groups], time.monotonic()
        time.sleep(SECONDS)
        after, passed_s = [cpu_s(group) for group in groups], time.monotonic() - began_s
        timings: list[DisplayTimings] = [receive(pipe) for pipe in pipes]
    shares = [
        ((main - main_before) / passed_s, (rest - rest_before) / passed_s)
        for (main, rest), (main_before, rest_before) in zip(after, before, strict=True)
    ]
    delays_ms = np.concatenate([np.array(one.delays_ns) for one in timings]) * 1e-6
    p50_ms, p99_ms = np.quantile(delays_ms, (0.5, 0.99))
    return Figures(
        p50_ms=float(p50_ms),
        p99_ms=float(p99_ms),
        lost=sum(one.lost for one in timings),
        loop=shares[0][0],
        zeromq=shares[0][1],
        relays=sum(shares[1]),
        displays=sum(shares[2]),
    )


def relay(connect: str, bind: str) -> None:
    """Relay until SIGTERM."""
    node = Relay(connect, bind)
    stop_on_signals(node.stop)
    node.run()


def receive(pipe: Connection) -> Any:
    """Return the message of a group of displays. Raises RuntimeError without one."""
    if not pipe.poll(PATIENCE_S):
        raise RuntimeError("the displays sent no report")
    try:
        return pipe.recv()
    except EOFError:
        raise RuntimeError("the displays could not join") from None


def cpu_s(group: list[BaseProcess]) -> tuple[float, float]:
    """Return the CPU time of processes so far in s: of main threads, of all others."""
    times_s = [thread_times_s(child.pid or 0) for child in group]
    return sum(main_s for main_s, _ in times_s), sum(rest_s for _, rest_s in times_s)
