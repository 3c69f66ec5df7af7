"""The forwarder of an emulated link: writes each packet at the time given by its link's model.

It runs as a process of its own, so that the parent's garbage collector delays no packet. It prints
the start time of the links. When its standard input closes, also because its parent ended, it
prints its counts and ends. Each line on standard input is a link's index, followed by its new
impairments, or by "drop" and its new packet filters as JSON.
"""

import heapq
import itertools
import json
import os
import select
import struct
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Literal

from protocol.histogram import Histogram
from protocol.host.process import freeze_objects
from telepulse.simulation.link_model import Direction
from telepulse.simulation.link_scene import parse_link
from tests.support.netem.namespace import MTU_BYTES

TCP = 6
SYN = 0x02
IPV4 = 4
IDLE_NS = 1_000_000_000
MAX_PACKETS = 64
# A pipe transfers lines up to this length whole.
MAX_COMMAND_BYTES = 4096
DROP = "drop "


@dataclass(frozen=True, slots=True)
class PacketFilter:
    """A rule that drops TCP packets of one link by their header, as a firewall would.

    port: the sensing node's; None: any. towards: packets to this node are dropped; None: packets
    to both. syn_only: drop connection requests and their answers only; established connections
    continue.
    """

    port: int | None = None
    towards: Literal["sensing", "display"] | None = None
    syn_only: bool = False

    def drops(self, packet: bytes, towards: str) -> bool:
        """Return whether an IPv4 packet on its way towards a node is dropped."""
        if self.towards not in (None, towards):
            return False
        header = 4 * (packet[0] & 0x0F)
        if packet[9] != TCP or len(packet) < header + 14:
            return False
        source, destination = struct.unpack_from("!HH", packet, header)
        if self.port not in (None, destination if towards == "sensing" else source):
            return False
        return not self.syn_only or bool(packet[header + 13] & SYN)


@dataclass(frozen=True, slots=True)
class ForwarderCounts:
    """Packets written, their bytes and those lost, and the lateness of writing in µs."""

    packets: int
    bytes: int
    lost: int
    late_p50_us: float | None
    late_p99_us: float | None
    late_max_us: float | None


class Forwarder:
    """Forwarder of IPv4 packets between pairs of TUN devices.

    pairs: for each link the descriptor of its device at the sensing node, and at the display.
    links: the links as `parse_link` reads them.
    """

    def __init__(self, pairs: Sequence[tuple[int, int]], links: Sequence[str], seed: int) -> None:
        self.began_ns = time.perf_counter_ns()
        self._pairs, self._seed = pairs, seed
        # By device: the direction that its packets take, and the device they come out of.
        self._paths: dict[int, tuple[Direction, int]] = {}
        # By device: the node that its packets go towards, and the filters on them.
        self._filters: dict[int, tuple[str, list[PacketFilter]]] = {}
        self._waiting: list[tuple[int, int, int, bytes]] = []
        self._order = itertools.count()
        self._packets = self._bytes = self._lost = 0
        self._late_us = Histogram(10.0, 1_000)
        for number, text in enumerate(links):
            self._change(number, text)

    def run(self, commands: int) -> None:
        """Forward until the descriptor `commands` is at its end, and execute its lines."""
        readable = [commands, *self._paths]
        while True:
            wait_ns = self._deliver()
            ready, _, _ = select.select(readable, [], [], wait_ns * 1e-9)
            if commands in ready:
                ready.remove(commands)
                data = os.read(commands, MAX_COMMAND_BYTES)
                if not data:
                    return
                for line in data.decode().splitlines():
                    self._execute(line)
            for tun in ready:
                self._receive(tun)

    def counts(self) -> ForwarderCounts:
        """Return the counts so far."""
        lost = self._lost + sum(direction.lost for direction, _ in self._paths.values())
        late_us = self._late_us
        quantiles_us = late_us.quantile(0.5), late_us.quantile(0.99)
        return ForwarderCounts(self._packets, self._bytes, lost, *quantiles_us, late_us.maximum)

    def _execute(self, line: str) -> None:
        number, _, text = line.partition(" ")
        if not text.startswith(DROP):
            self._change(int(number), text)
            return
        filters = [PacketFilter(**fields) for fields in json.loads(text.removeprefix(DROP))]
        for tun, towards in zip(self._pairs[int(number)], ("display", "sensing"), strict=True):
            self._filters[tun] = towards, filters

    def _change(self, number: int, text: str) -> None:
        """Change a link from now on; packets in transit still arrive."""
        link, seed, (near, far) = parse_link(text), self._seed + 2 * number, self._pairs[number]
        for tun, other, offset in ((near, far, 0), (far, near, 1)):
            if tun in self._paths:
                self._lost += self._paths[tun][0].lost
            self._paths[tun] = Direction(link, seed + offset, self.began_ns), other

    def _receive(self, tun: int) -> None:
        direction, other = self._paths[tun]
        towards, filters = self._filters.get(tun, ("", []))
        for _ in range(MAX_PACKETS):
            try:
                packet = os.read(tun, MTU_BYTES)
            except BlockingIOError:
                return
            # A new interface sends IPv6 neighbour requests, which would count as traffic.
            if packet[0] >> 4 != IPV4:
                continue
            if any(one.drops(packet, towards) for one in filters):
                self._lost += 1
                continue
            due_ns = direction.arrival_ns(time.perf_counter_ns(), len(packet))
            if due_ns is not None:
                heapq.heappush(self._waiting, (due_ns, next(self._order), other, packet))

    def _deliver(self) -> int:
        """Write the due packets; return the time in ns until the next one."""
        while self._waiting:
            late_ns = time.perf_counter_ns() - self._waiting[0][0]
            if late_ns < 0:
                return min(-late_ns, IDLE_NS)
            _, _, tun, packet = heapq.heappop(self._waiting)
            os.write(tun, packet)
            self._packets += 1
            self._bytes += len(packet)
            self._late_us.add(late_ns * 1e-3)
        return IDLE_NS


def main(arguments: list[str]) -> None:
    """Run a forwarder.

    The arguments are a seed; then, for n links, the n descriptors of the TUN devices at the
    sensing node, the n at the display, and the n links.
    """
    count = len(arguments) // 3
    near, far = map(int, arguments[1 : count + 1]), map(int, arguments[count + 1 : 2 * count + 1])
    pairs = list(zip(near, far, strict=True))
    forwarder = Forwarder(pairs, arguments[2 * count + 1 :], int(arguments[0]))
    with suppress(PermissionError):  # as in a container with no more rights than it needs
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    freeze_objects()
    print(json.dumps({"began_ns": forwarder.began_ns}), flush=True)
    forwarder.run(sys.stdin.fileno())
    print(json.dumps(asdict(forwarder.counts())), flush=True)
