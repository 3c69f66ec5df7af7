"""One run: a sensing node, relays, groups of many displays, and the cost of each of them."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.load.many_displays import DisplayTimings, run_many_displays
from benchmarks.load.sensing import Stream, sense
from protocol.host.process import stop_on_signals
from protocol.security.allow_list import allow
from protocol.security.keys import ClientKeys, ServerKeys, new_pair, read_pair
from telepulse.processes import free_addresses
from telepulse.relay import Relay

SECONDS = 5.0
PATIENCE_S = 60.0
_spawn = get_context("spawn")


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
        server, client = processes.enter_context(made_keys()) if load.keys else (None, None)
        sensing = processes.enter_context(process(sense, load.stream, addresses[0], server))
        relays = [
            processes.enter_context(process(relay, addresses[0], address))
            for address in addresses[1:]
        ]
        displays, pipes = [], []
        listening = addresses[1:] or addresses
        for number, address in enumerate(listening):
            count = len(range(number, load.displays, len(listening)))
            ours, theirs = _spawn.Pipe()
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


@contextmanager
def made_keys() -> Iterator[tuple[ServerKeys, ClientKeys]]:
    """Provide keys of a sensing node and of displays on its allow-list."""
    with TemporaryDirectory(prefix="telepulse-") as folder:
        wrist, finger = (read_pair(new_pair(Path(folder), name)[0]) for name in ("wrist", "finger"))
        allowed = Path(folder) / "allowed"
        allow(allowed, finger.public)
        yield ServerKeys(wrist, allowed), ClientKeys(finger, wrist.public)


def relay(connect: str, bind: str) -> None:
    """Relay until SIGTERM."""
    node = Relay(connect, bind)
    stop_on_signals(node.stop)
    node.run()


@contextmanager
def process(target: Callable[..., None], *arguments: Any) -> Iterator[BaseProcess]:
    """Run `target` in a process until the block ends."""
    child = _spawn.Process(target=target, args=arguments, daemon=True)
    child.start()
    try:
        yield child
    finally:
        child.terminate()
        child.join()


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
    main = rest = 0.0
    for child in group:
        for thread in Path(f"/proc/{child.pid}/task").iterdir():
            ran_s = int((thread / "schedstat").read_text(encoding="ascii").split()[0]) * 1e-9
            if int(thread.name) == child.pid:
                main += ran_s
            else:
                rest += ran_s
    return main, rest
