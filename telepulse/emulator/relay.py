"""The relay between two TUN devices: each packet is written when the model of the link says so.

A process of its own, so that nobody's garbage collector delays packets. It prints when the link
begins, and what it has carried when its standard input is closed, as by its parent's end.
"""

import heapq
import itertools
import json
import os
import select
import sys
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any

from protocol.histogram import Histogram
from telepulse.emulator.tun import MTU_BYTES
from telepulse.link import Direction, parse_link

IDLE_NS = 1_000_000_000
MAX_PACKETS = 64
IPV4 = 4


@dataclass(frozen=True, slots=True)
class Carried:
    """What a relay has done: packets written, packets lost, and how late packets were written
    against the model, in µs."""

    packets: int
    lost: int
    late_p50_us: float | None
    late_p99_us: float | None
    late_max_us: float | None


class Relay:
    """Carries IPv4 packets between two TUN devices; the first is at the sensing node."""

    def __init__(self, tuns: tuple[int, int], down: Direction, up: Direction) -> None:
        """down: from the first device to the second; up: the other way."""
        self._ways = {tuns[0]: (down, tuns[1]), tuns[1]: (up, tuns[0])}
        self._waiting: list[tuple[int, int, int, bytes]] = []
        self._order = itertools.count()
        self._packets = 0
        self._late_us = Histogram(10.0, 1_000)

    def run(self, until_readable: int) -> None:
        """Relay until the descriptor `until_readable` has something to read."""
        readable = [until_readable, *self._ways]
        while True:
            wait_ns = self._deliver()
            ready, _, _ = select.select(readable, [], [], wait_ns * 1e-9)
            if until_readable in ready:
                return
            for tun in ready:
                self._receive(tun)

    def carried(self) -> Carried:
        """What was done so far."""
        lost = sum(direction.lost for direction, _ in self._ways.values())
        late_us = self._late_us
        quantiles_us = late_us.quantile(0.5), late_us.quantile(0.99)
        return Carried(self._packets, lost, *quantiles_us, late_us.maximum)

    def _receive(self, tun: int) -> None:
        direction, other = self._ways[tun]
        for _ in range(MAX_PACKETS):
            try:
                packet = os.read(tun, MTU_BYTES)
            except BlockingIOError:
                return
            # A new interface asks about IPv6 neighbours, which would be counted as traffic.
            if packet[0] >> 4 != IPV4:
                continue
            due_ns = direction.arrival_ns(time.monotonic_ns(), len(packet))
            if due_ns is not None:
                heapq.heappush(self._waiting, (due_ns, next(self._order), other, packet))

    def _deliver(self) -> int:
        """Write what is due; how long until the next packet is."""
        while self._waiting:
            late_ns = time.monotonic_ns() - self._waiting[0][0]
            if late_ns < 0:
                return min(-late_ns, IDLE_NS)
            _, _, tun, packet = heapq.heappop(self._waiting)
            os.write(tun, packet)
            self._packets += 1
            self._late_us.add(late_ns * 1e-3)
        return IDLE_NS


def main(arguments: list[str]) -> None:
    """Run a relay: two descriptors of TUN devices, a link as `parse_link` reads it, a seed."""
    near, far, text, seed = arguments
    scene, began_ns = parse_link(text), time.monotonic_ns()
    down, up = Direction(scene, int(seed), began_ns), Direction(scene, int(seed) + 1, began_ns)
    with suppress(PermissionError):  # as in a container that was given no more than it needs
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    relay = Relay((int(near), int(far)), down, up)
    _say({"began_ns": began_ns})
    relay.run(sys.stdin.fileno())
    _say(asdict(relay.carried()))


def _say(table: dict[str, Any]) -> None:
    print(json.dumps(table), flush=True)
