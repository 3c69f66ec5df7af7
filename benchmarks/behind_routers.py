"""Delay of each way through a third machine; needs root."""

import io
import statistics
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path

from benchmarks.benchmark import Benchmark
from tests.support.routers import ROUTER_ADDRESS, Sites, behind_routers, run_within
from tests.support.ways import WAYS, Ends, missing, nodes_keys, play

SECONDS = 10
TURNS = 3


def main(benchmark: Benchmark) -> None:
    """Print the delay of the ways, played in turns."""
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


def _delay_ms(name: str) -> tuple[float, float]:
    """Return median and 99th percentile of the delay from the wrist to the display."""
    with tempfile.TemporaryDirectory() as path, behind_routers() as sites:
        folder = Path(path)
        keys = nodes_keys(folder)
        way = WAYS[name][0] if name in WAYS else _port_forwarding
        with way(sites, folder) as ends, redirect_stdout(io.StringIO()):
            _, played = play(sites, ends, keys, folder, SECONDS)
    delay_ms = played["one_way_delay_ms"]
    return delay_ms["p50"], delay_ms["p99"]


@contextmanager
def _port_forwarding(sites: Sites, folder: Path) -> Iterator[Ends]:
    """Let the wrist's router pass its ports: the same path without any way through."""
    rule = "-i outer -p tcp --dport 5555:5556"
    run_within(
        sites.router,
        f"iptables -t nat -A PREROUTING {rule} -j DNAT --to-destination 192.168.1.10",
        f"iptables -I FORWARD {rule} -j ACCEPT",
    )
    yield Ends(("--bind", "tcp://*:5555"), f"tcp://{ROUTER_ADDRESS}:5555")
