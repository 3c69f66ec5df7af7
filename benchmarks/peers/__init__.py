"""One-way latency at 1 kHz on loopback, process to process, of telepulse and its alternatives.

All peers take the time of a message right before they encode it, and again when its value can be
used: for telepulse when it is in the jitter buffer, decoded, checked and not a duplicate. "done" is
when the subscriber has finished with it: for telepulse, after the update of the delay estimate.
"Decoded only" is the part of telepulse that every display needs. Peers run in turns, in rounds of
alternating order. pyzmq is used with msgpack.
"""

from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from benchmarks.benchmark import Benchmark
from benchmarks.peers import others, ours
from benchmarks.peers.race import Publish, Run, Subscribe, run

ROUNDS = 6
MESSAGES = 2_000
QUANTILES = (50.0, 99.0)


@dataclass(frozen=True, slots=True)
class Peer:
    """A row of the table: its ends, and the packages that it needs."""

    name: str
    publish: Publish
    subscribe: Subscribe
    packages: tuple[str, ...] = ()
    curve: bool = False

    @property
    def versions(self) -> str | None:
        """Return the versions of its packages; None when one is not installed."""
        try:
            return ", ".join(f"{package} {version(package)}" for package in self.packages)
        except PackageNotFoundError:
            return None

    def run(self, messages: int) -> Run:
        """Run it once."""
        return run(self.publish, self.subscribe, self.curve, messages)


BARE = Peer("pyzmq", others.publish_pyzmq, others.subscribe_pyzmq, ("pyzmq", "msgpack"))
OURS = Peer("telepulse", ours.publish, ours.subscribe)
DECODED = Peer("decoded only", ours.publish, ours.subscribe_decoded)
BARE_CURVE = replace(BARE, name="pyzmq, CURVE", curve=True)
OURS_CURVE = replace(OURS, name="telepulse, CURVE", curve=True)
LSL = Peer("LSL", others.publish_lsl, others.subscribe_lsl, ("pylsl",))
ZENOH = Peer("zenoh", others.publish_zenoh, others.subscribe_zenoh, ("eclipse-zenoh",))
PEERS = (BARE, DECODED, OURS, BARE_CURVE, OURS_CURVE, LSL, ZENOH)
COMPARED = ((OURS, BARE), (OURS_CURVE, BARE_CURVE), (OURS, LSL))


def main(benchmark: Benchmark) -> None:
    """Print the table and the versions."""
    rounds, messages = (1, 50) if benchmark.quick else (ROUNDS, MESSAGES)
    runs = run_in_turns(PEERS, rounds, messages)
    columns = ("peer", "p50", "p99", "done", "CPU", "lost", "disorder", "/ pyzmq", "/ LSL")
    benchmark.table(
        f"Peers at 1 kHz, {rounds} rounds of {messages} messages: one-way latency, done"
        " (p50) and the subscriber's CPU time a message, in µs; p50 over that of others",
        columns,
        [row(peer, runs) for peer in PEERS],
    )
    for peer, other in COMPARED:
        if (found := ratio(peer, other, runs)) is not None:
            benchmark.judge(f"p50 of {peer.name} over that of {other.name}", found)
    print("; ".join(dict.fromkeys(peer.versions for peer in runs if peer.versions)))


def run_in_turns(peers: tuple[Peer, ...], rounds: int, messages: int) -> dict[Peer, list[Run]]:
    """Return all runs of the installed peers, one a round."""
    there = [peer for peer in peers if peer.versions is not None]
    runs: dict[Peer, list[Run]] = {peer: [] for peer in there}
    for number in range(rounds):
        for peer in there if number % 2 == 0 else reversed(there):
            runs[peer].append(peer.run(messages))
    return runs


def row(peer: Peer, runs: dict[Peer, list[Run]]) -> tuple[str, ...]:
    """Return a peer's row."""
    if peer not in runs:
        return peer.name, "not installed"
    mine = runs[peer]
    delays_us = np.concatenate([each.delays_ns for each in mine]) * 1e-3
    done_us = np.concatenate([each.done_ns for each in mine]) * 1e-3
    cpu_us = sum(each.cpu_ns for each in mine) * 1e-3 / len(delays_us)
    return (
        peer.name,
        *(f"{value:.0f}" for value in np.percentile(delays_us, QUANTILES)),
        f"{np.median(done_us):.0f}",
        f"{cpu_us:.0f}",
        str(sum(each.lost for each in mine)),
        str(sum(each.disordered for each in mine)),
        *(_shown(ratio(peer, other, runs)) for other in (BARE, LSL)),
    )


def ratio(peer: Peer, other: Peer, runs: dict[Peer, list[Run]]) -> float | None:
    """Return the median over rounds of the peer's p50 over the other's; None without runs."""
    if peer not in runs or other not in runs:
        return None
    pairs = zip(runs[peer], runs[other], strict=True)
    return float(np.median([np.median(a.delays_ns) / np.median(b.delays_ns) for a, b in pairs]))


def _shown(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"
