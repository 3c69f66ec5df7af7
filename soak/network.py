"""The network between the disturbed nodes.

As root it is emulated links between namespaces, otherwise a proxy on the loopback interface. Each
link can be degraded while it is used.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from subprocess import PIPE
from typing import IO

from protocol.host.child_process import ChildProcess
from telepulse.processes import free_addresses
from telepulse.simulation.link_scene import LinkScene, parse_link
from tests.support.netem import EmulatedLink, Namespace, emulate

CALM = "delay=10ms,jitter=1ms"
LINKS = 4
"""Two of them lead to the continuous display, one each to the restarted and the temporary one."""
PORT = 5555
STARTS_WITHIN_S = 30.0


@dataclass(slots=True)
class Network:
    """The links of a soak.

    kind: its description. bind: address that the sensing node binds. near: address to reach it
    without a link. addresses: address to reach it over each link.
    """

    kind: str
    bind: str
    near: str
    addresses: list[str]
    sensing: Namespace | None
    display: Namespace | None
    _emulated: EmulatedLink | None = None
    _orders: IO[str] | None = None

    def change(self, number: int, changes: str = "") -> None:
        """Set a link to calm, with these changes."""
        table = dict(part.split("=") for part in f"{CALM},{changes}".split(",") if part)
        scene = parse_link(",".join(f"{key}={value}" for key, value in table.items()))
        if self._emulated is not None:
            self._emulated.change(scene, number)
        elif self._orders is not None:
            self._orders.write(f"{number} {scene.text()}\n")
            self._orders.flush()


@contextmanager
def namespaces(seed: int) -> Iterator[Network]:
    """Provide links between two namespaces. Raises EmulatorError."""
    with emulate(*[_calm()] * LINKS, seed=seed) as emulated:
        yield Network(
            "kernel TCP between namespaces",
            f"tcp://*:{PORT}",
            f"tcp://127.0.0.1:{PORT}",
            [f"tcp://{address}:{PORT}" for address in emulated.sensing.addresses],
            emulated.sensing,
            emulated.display,
            emulated,
        )


@contextmanager
def loopback(seed: int) -> Iterator[Network]:
    """Provide links through a proxy on this machine."""
    near, *addresses = free_addresses(1 + LINKS)
    command = ("-m", "soak.proxy", str(seed), near, *addresses)
    with ChildProcess("proxy on loopback", *command, stdin=PIPE, stdout=PIPE) as proxy:
        assert proxy.stdin is not None
        proxy.read_line(STARTS_WITHIN_S)
        yield Network("a proxy on loopback", near, near, addresses, None, None, _orders=proxy.stdin)


def _calm() -> LinkScene:
    return parse_link(CALM)
