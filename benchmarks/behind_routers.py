"""Delay of each way through a third machine, and what a tunnel of the relay costs; needs root."""

import io
import json
import socket
import statistics
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from subprocess import PIPE

from benchmarks.benchmark import Benchmark
from protocol.host.child_process import ChildProcess
from telepulse.processes import cpu_time_s, free_addresses
from tests.support.hostile_peers import GREETING, port_of
from tests.support.routers import ROUTER_ADDRESS, Sites, behind_routers, run_within
from tests.support.ways import WAYS, Ends, ThreeKeyrings, missing, play

SECONDS = 10
TURNS = 3
TRIPS, MESSAGE_BYTES = 2_000, 100
BULK_BYTES = 100_000_000
CHUNK_BYTES = 65_536
HOST = "127.0.0.1"


def main(benchmark: Benchmark) -> None:
    """Print the delay of the ways in turns, and the time and processor time of a tunnel."""
    names = ["port forwarding", *(name for name in WAYS if missing(name) is None)]
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    for _ in range(TURNS):
        for name in names:
            found[name].append(_delay_ms(name))
    rows = []
    for name, delays_ms in found.items():
        p50_ms, p99_ms = (statistics.median(column) for column in zip(*delays_ms, strict=True))
        rows.append((name, f"{p50_ms:.2f}", f"{p99_ms:.2f}"))
    title = f"One-way delay of frames, median of {TURNS} runs of {SECONDS} s"
    benchmark.table(title, ("way", "p50 ms", "p99 ms"), rows)
    _print_costs(benchmark)


def _delay_ms(name: str) -> tuple[float, float]:
    """Return median and 99th percentile of the delay from the wrist to the display."""
    with tempfile.TemporaryDirectory() as path, behind_routers() as sites:
        folder = Path(path)
        keys = ThreeKeyrings(folder)
        way = WAYS[name][0] if name in WAYS else _port_forwarding
        with way(sites, keys, folder) as ends, redirect_stdout(io.StringIO()):
            _, played = play(sites, ends, keys, folder, SECONDS)
    delay_ms = played["one_way_delay_ms"]
    return delay_ms["p50"], delay_ms["p99"]


@contextmanager
def _port_forwarding(sites: Sites, keys: ThreeKeyrings, folder: Path) -> Iterator[Ends]:
    """Let the wrist's router pass its ports: the same path without any way through."""
    rule = "-i outer -p tcp --dport 5555:5556"
    run_within(
        sites.router,
        f"iptables -t nat -A PREROUTING {rule} -j DNAT --to-destination 192.168.1.10",
        f"iptables -I FORWARD {rule} -j ACCEPT",
    )
    yield Ends(("--bind", "tcp://*:5555"), f"tcp://{ROUTER_ADDRESS}:5555")


def _print_costs(benchmark: Benchmark) -> None:
    """Print round trips, rate and processor time of plain TCP, direct and through a tunnel."""
    bind, nodes, served = free_addresses(3)
    listener = socket.create_server((HOST, port_of(served)))
    threading.Thread(target=_serve, args=(listener,), daemon=True).start()
    node = {"relay": nodes, "key": None, "peer": None, "host": HOST, "port": str(port_of(served))}
    relay = ("tunnel", "-m", "telepulse", "tunnel", "--bind", bind, "--nodes", nodes)
    dial_out = ("dial-out", "-m", "sensing_node.dial_out", json.dumps(node))
    with (
        ChildProcess(*relay, stderr=PIPE) as one,
        ChildProcess(*dial_out, stdin=PIPE, stdout=PIPE) as other,
    ):
        one.read_line(30, from_stderr=True)
        rows = []
        for name, port in (("direct", port_of(served)), ("tunnel", port_of(bind))):
            # A display waits until the sensing node has registered.
            with _called(port) as connection:
                began_s = _cpu_s(one, other)
                trips_us = _round_trips_us(connection)
                each_us = (_cpu_s(one, other) - began_s) / (2 * TRIPS) * 1e6
                began_s = time.perf_counter()
                connection.sendall(b"B" * MESSAGE_BYTES)
                _read(connection, BULK_BYTES)
                rate = BULK_BYTES / (time.perf_counter() - began_s) * 1e-6
            quantiles = statistics.quantiles(trips_us, n=100)
            texts = f"{quantiles[49]:.0f}", f"{quantiles[98]:.0f}", f"{each_us:.0f}", f"{rate:.0f}"
            rows.append((name, *texts))
    title = f"Plain TCP over loopback, {TRIPS} round trips of {MESSAGE_BYTES} bytes"
    columns = ("", "round trip p50 µs", "p99 µs", "processor µs a message", "bulk MB/s")
    benchmark.table(title, columns, rows)


def _cpu_s(*processes: ChildProcess) -> float:
    return sum(cpu_time_s(process.pid) for process in processes)


@contextmanager
def _called(port: int) -> Iterator[socket.socket]:
    with socket.create_connection((HOST, port)) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(GREETING)
        _read(connection, len(GREETING))
        yield connection


def _round_trips_us(connection: socket.socket) -> list[float]:
    message, trips_us = bytes(MESSAGE_BYTES), []
    for _ in range(TRIPS):
        began_ns = time.perf_counter_ns()
        connection.sendall(message)
        _read(connection, MESSAGE_BYTES)
        trips_us.append((time.perf_counter_ns() - began_ns) * 1e-3)
    return trips_us


def _read(connection: socket.socket, count: int) -> None:
    while count > 0:
        data = connection.recv(min(count, CHUNK_BYTES))
        if not data:
            raise ConnectionError("the other end has closed the connection")
        count -= len(data)


def _serve(listener: socket.socket) -> None:
    """Send back what comes; after a message of B, send as much as is asked for."""
    with suppress(OSError):
        while True:
            connection, _ = listener.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            threading.Thread(target=_echo, args=(connection,), daemon=True).start()


def _echo(connection: socket.socket) -> None:
    with connection, suppress(OSError):
        while data := connection.recv(CHUNK_BYTES):
            if data[:1] != b"B":
                connection.sendall(data)
                continue
            for _ in range(BULK_BYTES // CHUNK_BYTES + 1):
                connection.sendall(bytes(CHUNK_BYTES))
