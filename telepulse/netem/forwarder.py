"""The relay between pairs of TUN devices: each packet is written when
the model of its link says so.

A process of its own, so that nobody's garbage collector delays packets. It prints when the link
begins, and what it has carried when its standard input is closed, as by its parent's end. Until
then a line there, the number of a link and what it is like from now on, changes that link; where
"drop" and packet filters follow the number, those replace the link's filters.

Packets that an emulated link drops by their TCP header, as a firewall would.
"""

import heapq
import itertools
import json
import os
import select
import struct
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, Literal

from protocol.histogram import Histogram
from protocol.host.measures import freeze_objects
from telepulse.netem.namespace import MTU_BYTES
from telepulse.simulation.link_model import Direction, parse_link

TCP = 6
SYN = 0x02


@dataclass(frozen=True, slots=True)
class PacketFilter:
    """A rule that drops TCP packets of one link.

    port: the sensing node's; None: any. towards: the node that does not receive them, None: both.
    syn_only: requests to connect and their answers alone; established connections go on.
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


def write_filters(filters: Iterable[PacketFilter]) -> str:
    """Return filters as one line of text."""
    return json.dumps([asdict(one) for one in filters])


def read_filters(text: str) -> tuple[PacketFilter, ...]:
    """Return the filters in a line that `write_filters` wrote."""
    return tuple(PacketFilter(**fields) for fields in json.loads(text))


IDLE_NS = 1_000_000_000
MAX_PACKETS = 64
# A pipe takes and gives a line of this length whole.
MAX_ORDER_BYTES = 4096
IPV4 = 4
DROP = "drop "


@dataclass(frozen=True, slots=True)
class ForwarderCounts:
    """The account of a relay: packets written, packets lost, and how late packets were written
    against the model, in µs."""

    packets: int
    lost: int
    late_p50_us: float | None
    late_p99_us: float | None
    late_max_us: float | None


class Forwarder:
    """Carries IPv4 packets between TUN devices.

    ways: for each device the direction that its packets take, and the device they come out of.
    """

    def __init__(self, ways: dict[int, tuple[Direction, int]]) -> None:
        self._ways = ways
        self._waiting: list[tuple[int, int, int, bytes]] = []
        self._order = itertools.count()
        # By device: the node that its packets go towards, and what of them is dropped.
        self._filters: dict[int, tuple[str, tuple[PacketFilter, ...]]] = {}
        self._packets = self._lost = 0
        self._late_us = Histogram(10.0, 1_000)

    def run(self, orders: int, obey: Callable[[bytes], None]) -> None:
        """Relay until the descriptor `orders` is at its end; what can be read of it is obeyed."""
        readable = [orders, *self._ways]
        while True:
            wait_ns = self._deliver()
            ready, _, _ = select.select(readable, [], [], wait_ns * 1e-9)
            if orders in ready:
                ready.remove(orders)
                data = os.read(orders, MAX_ORDER_BYTES)
                if not data:
                    return
                obey(data)
            for tun in ready:
                self._receive(tun)

    def redirect(self, tun: int, direction: Direction) -> None:
        """Send this device's packets another way from now on; those under way arrive."""
        former, other = self._ways[tun]
        self._lost += former.lost
        self._ways[tun] = direction, other

    def drop(self, tun: int, towards: str, filters: tuple[PacketFilter, ...]) -> None:
        """Drop from now on what these filters name of the packets of this device."""
        self._filters[tun] = towards, filters

    def carried(self) -> ForwarderCounts:
        """Return the account so far."""
        lost = self._lost + sum(direction.lost for direction, _ in self._ways.values())
        late_us = self._late_us
        quantiles_us = late_us.quantile(0.5), late_us.quantile(0.99)
        return ForwarderCounts(self._packets, lost, *quantiles_us, late_us.maximum)

    def _receive(self, tun: int) -> None:
        direction, other = self._ways[tun]
        towards, filters = self._filters.get(tun, ("", ()))
        for _ in range(MAX_PACKETS):
            try:
                packet = os.read(tun, MTU_BYTES)
            except BlockingIOError:
                return
            # A new interface asks about IPv6 neighbours, which would be counted as traffic.
            if packet[0] >> 4 != IPV4:
                continue
            if any(one.drops(packet, towards) for one in filters):
                self._lost += 1
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
    """Run a relay: a seed; then, for n links, the n descriptors of the TUN devices at the sensing
    node, the n at the display, and the n links as `parse_link` reads them."""
    seed, count = int(arguments[0]), len(arguments) // 3
    near, far = map(int, arguments[1 : count + 1]), map(int, arguments[count + 1 : 2 * count + 1])
    pairs = list(zip(near, far, strict=True))
    began_ns = time.monotonic_ns()

    def directions(number: int, text: str) -> tuple[Direction, Direction]:
        link, chances = parse_link(text), seed + 2 * number
        return Direction(link, chances, began_ns), Direction(link, chances + 1, began_ns)

    ways = {}
    for number, (one, other) in enumerate(pairs):
        there, back = directions(number, arguments[2 * count + 1 + number])
        ways[one], ways[other] = (there, other), (back, one)
    with suppress(PermissionError):  # as in a container that was given no more than it needs
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    relay = Forwarder(ways)

    def obey(data: bytes) -> None:
        for line in data.decode().splitlines():
            number, _, text = line.partition(" ")
            pair = pairs[int(number)]
            if text.startswith(DROP):
                filters = read_filters(text.removeprefix(DROP))
                for tun, towards in zip(pair, ("display", "sensing"), strict=True):
                    relay.drop(tun, towards, filters)
                continue
            for tun, direction in zip(pair, directions(int(number), text), strict=True):
                relay.redirect(tun, direction)

    freeze_objects()
    _say({"began_ns": began_ns})
    relay.run(sys.stdin.fileno(), obey)
    _say(asdict(relay.carried()))


def _say(table: dict[str, Any]) -> None:
    print(json.dumps(table), flush=True)
