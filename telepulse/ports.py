"""Free addresses on this machine, for nodes that are started together."""

import itertools
import random
from contextlib import ExitStack
from socket import AF_INET, SOCK_STREAM, socket

HOST = "127.0.0.1"
# Below the ports that systems give to outgoing connections: a node that connects to one of those
# before its peer has bound it can be given that very port, and then connects to itself.
PORTS = range(15_000, 32_000, 2)
# None is given again soon: who was given it need not have bound it yet.
_ports = itertools.cycle(random.SystemRandom().sample(PORTS, len(PORTS)))


def free_addresses(count: int) -> list[str]:
    """Different loopback addresses whose port and the next one nobody holds."""
    addresses: list[str] = []
    with ExitStack() as held:
        while len(addresses) < count:
            port = next(_ports)
            try:
                for number in (port, port + 1):
                    holder = held.enter_context(socket(AF_INET, SOCK_STREAM))
                    holder.bind((HOST, number))
            except OSError:
                continue
            addresses.append(f"tcp://{HOST}:{port}")
    return addresses
