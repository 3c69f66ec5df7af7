"""Two namespaces and the links between them, as one thing to use in a `with`."""

import json
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from subprocess import PIPE
from typing import IO

from protocol.errors import ProcessError
from protocol.host.child_process import ChildProcess
from telepulse.netem.forwarder import DROP, ForwarderCounts, PacketFilter, write_filters
from telepulse.netem.namespace import EmulatorError, Namespace
from telepulse.simulation.link_model import LinkScene

# Nobody but the two namespaces ever sees these addresses; one network for each link.
SENSING_ADDRESS, DISPLAY_ADDRESS = "10.77.{}.1", "10.77.{}.2"
ANSWERS_WITHIN_S = 30.0


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
        with relay:
            assert relay.stdin is not None
            link = EmulatedLink(sensing, display, _receive(relay)["began_ns"], relay.stdin)
            yield link
            relay.close_input()
            link.carried = ForwarderCounts(**_receive(relay))


def _start_relay(
    near: Sequence[int], far: Sequence[int], scenes: Sequence[LinkScene], seed: int
) -> ChildProcess:
    tuns = (*near, *far)
    arguments = (str(seed), *map(str, tuns), *(scene.text() for scene in scenes))
    command = ("-m", "telepulse.netem", *arguments)
    return ChildProcess(
        "relay of the emulated link", *command, stdin=PIPE, stdout=PIPE, stderr=PIPE, pass_fds=tuns
    )


def _receive(relay: ChildProcess) -> dict[str, int]:
    """Return the next table that the relay prints. Raises EmulatorError."""
    try:
        table: dict[str, int] = json.loads(relay.read_line(ANSWERS_WITHIN_S))
    except ProcessError as error:
        raise EmulatorError(str(error)) from None
    return table
