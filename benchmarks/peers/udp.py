"""Raw UDP: the least cost of a message between two Python processes."""

import time
from collections.abc import Iterable, Iterator
from socket import AF_INET, SOCK_DGRAM, socket

from benchmarks.peers.message import FIELDS, VALUE, Arrival, Wire


def publish(wire: Wire, numbers: Iterable[int]) -> None:
    """Send a message for each number."""
    sender = socket(AF_INET, SOCK_DGRAM)
    address = ("127.0.0.1", wire.port)
    for sequence in numbers:
        sender.sendto(FIELDS.pack(sequence, time.perf_counter_ns(), VALUE), address)


def subscribe(wire: Wire) -> Iterator[Arrival]:
    """Yield messages as they arrive."""
    receiver = socket(AF_INET, SOCK_DGRAM)
    receiver.bind(("127.0.0.1", wire.port))
    while True:
        sequence, sent_ns, _ = FIELDS.unpack(receiver.recv(FIELDS.size))
        yield Arrival(sequence, sent_ns, time.perf_counter_ns())
