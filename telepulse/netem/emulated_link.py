"""Two namespaces and the links between them, as one thing to use in a `with`."""

import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import IO

from telepulse.netem.forwarder import DROP, ForwarderCounts, PacketFilter, write_filters
from telepulse.netem.namespace import EmulatorError, Namespace
from telepulse.simulation.link_model import LinkScene

# Nobody but the two namespaces ever sees these addresses; one network for each link.
SENSING_ADDRESS, DISPLAY_ADDRESS = "10.77.{}.1", "10.77.{}.2"


@dataclass(slots=True)
class EmulatedLink:
    """One link or several between two namespaces, which have an address on each.

    began_ns: when the links' time began, on this machine's monotonic clock. orders: where the
    relay is told of changes. carried: what it has done on all of them, once they have ended.
    """

    sensing: Namespace
    display: Namespace
    began_ns: int
    orders: IO[str]
    carried: ForwarderCounts | None = None

    def change(self, scene: LinkScene, number: int = 0) -> None:
        """Change one of the links from now on; what is under way arrives."""
        self.orders.write(f"{number} {scene.text()}\n")
        self.orders.flush()

    def drop(self, *filters: PacketFilter, number: int = 0) -> None:
        """Drop what these filters name on one of the links, and nothing else; none: nothing."""
        self.orders.write(f"{number} {DROP}{write_filters(filters)}\n")
        self.orders.flush()


@contextmanager
def emulate(*scenes: LinkScene, seed: int = 1) -> Iterator[EmulatedLink]:
    """A link for each scene, all between the same two namespaces, within a `with`.

    Several such pairs may stand side by side. The same seed gives the same chances, but which
    packet meets them is the kernel's affair. What was started in the namespaces is to be ended
    before. Raises EmulatorError.
    """
    numbers = range(len(scenes))
    with (
        closing(Namespace([SENSING_ADDRESS.format(number) for number in numbers])) as sensing,
        closing(Namespace([DISPLAY_ADDRESS.format(number) for number in numbers])) as display,
    ):
        relay = _start_relay(sensing.tuns, display.tuns, scenes, seed)
        try:
            assert relay.stdin is not None
            link = EmulatedLink(sensing, display, _hear(relay)["began_ns"], relay.stdin)
            yield link
            _end(relay)
            link.carried = ForwarderCounts(**_hear(relay))
        finally:
            relay.kill()
            relay.communicate()


def _start_relay(
    near: Sequence[int], far: Sequence[int], scenes: Sequence[LinkScene], seed: int
) -> subprocess.Popen[str]:
    tuns = (*near, *far)
    texts = (scene.text() for scene in scenes)
    return subprocess.Popen(
        [sys.executable, "-m", "telepulse.netem", str(seed), *map(str, tuns), *texts],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        pass_fds=tuns,
        # Ctrl-C is for the caller, who ends the relay.
        start_new_session=True,
    )


def _hear(relay: subprocess.Popen[str]) -> dict[str, int]:
    """The next line that the relay says. Raises EmulatorError."""
    assert relay.stdout is not None
    line = relay.stdout.readline()
    if not line:
        _, errors = relay.communicate()
        last = errors.strip().splitlines()[-1:] or ["it said nothing"]
        raise EmulatorError(f"the relay of the emulated link ended: {last[0]}")
    table: dict[str, int] = json.loads(line)
    return table


def _end(relay: subprocess.Popen[str]) -> None:
    assert relay.stdin is not None
    relay.stdin.close()
    # So that communicate, later, does not flush what is closed.
    relay.stdin = None
