"""The network between the disturbed nodes: links between namespaces, each degraded while in use."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from telepulse.simulation.link_scene import LinkScene, parse_link
from tests.support.netem import EmulatedLink, EmulatorError, Namespace, emulate, unavailable

CALM = "delay=10ms,jitter=1ms"
LINKS = 4
"""Two of them lead to the continuous display, one each to the restarted and the temporary one."""
PORT = 5555


@dataclass(slots=True)
class Network:
    """The links of a soak.

    bind: address that the sensing node binds. near: address to reach it without a link. addresses:
    address to reach it over each link.
    """

    bind: str
    near: str
    addresses: list[str]
    sensing: Namespace
    display: Namespace
    _emulated: EmulatedLink

    def change(self, number: int, changes: str = "") -> None:
        """Set a link to calm, with these changes."""
        table = dict(part.split("=") for part in f"{CALM},{changes}".split(",") if part)
        scene = parse_link(",".join(f"{key}={value}" for key, value in table.items()))
        self._emulated.change(scene, number)


@contextmanager
def namespaces(seed: int) -> Iterator[Network]:
    """Provide links between two namespaces. Raises EmulatorError."""
    if (reason := unavailable()) is not None:
        raise EmulatorError(reason)
    with emulate(*[_calm()] * LINKS, seed=seed) as emulated:
        yield Network(
            f"tcp://*:{PORT}",
            f"tcp://127.0.0.1:{PORT}",
            [f"tcp://{address}:{PORT}" for address in emulated.sensing.addresses],
            emulated.sensing,
            emulated.display,
            emulated,
        )


def _calm() -> LinkScene:
    return parse_link(CALM)
