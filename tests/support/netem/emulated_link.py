"""Two namespaces and the emulated links between them."""

import json
import os
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from subprocess import PIPE
from typing import IO

from protocol.errors import ProcessError
from protocol.host.child_process import ChildProcess
from telepulse.simulation.link_scene import LinkScene
from tests.support.netem.forwarder import DROP, ForwarderCounts, PacketFilter
from tests.support.netem.namespace import EmulatorError, Namespace

ROOT = Path(__file__).resolve().parents[3]
# Addresses inside the two namespaces, with one network for each link.
SENSING_ADDRESS, DISPLAY_ADDRESS = "10.77.{}.1", "10.77.{}.2"
ANSWERS_WITHIN_S = 30.0


@dataclass(slots=True)
class EmulatedLink:
    """One link or several between two namespaces, which have an address on each.

    began_ns: start of the links' time, on this machine's monotonic clock. commands: input of the
    forwarder. carried: the counts of all links, once they have ended.
    """

    sensing: Namespace
    display: Namespace
    began_ns: int
    commands: IO[str]
    carried: ForwarderCounts | None = None

    def change(self, scene: LinkScene, link_index: int = 0) -> None:
        """Change one of the links from now on; packets in transit still arrive."""
        self.commands.write(f"{link_index} {scene.text()}\n")
        self.commands.flush()

    def drop(self, *filters: PacketFilter, link_index: int = 0) -> None:
        """Drop the packets that match these filters on a link, in place of earlier filters."""
        table = json.dumps([asdict(one) for one in filters])
        self.commands.write(f"{link_index} {DROP}{table}\n")
        self.commands.flush()


@contextmanager
def emulate(*scenes: LinkScene, seed: int = 1) -> Iterator[EmulatedLink]:
    """Make a link for each scene, all between the same two namespaces.

    Several such pairs can run side by side. The same seed gives the same impairments in time;
    the kernel decides which packet meets them. Programs in the namespaces must have ended at the
    end of the context. Raises EmulatorError.
    """
    numbers = range(len(scenes))
    with (
        closing(Namespace([SENSING_ADDRESS.format(number) for number in numbers])) as sensing,
        closing(Namespace([DISPLAY_ADDRESS.format(number) for number in numbers])) as display,
    ):
        tuns = (*sensing.tuns, *display.tuns)
        arguments = (str(seed), *map(str, tuns), *(scene.text() for scene in scenes))
        # Its modules are those of this tree, which is not installed.
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        command = ("forwarder of the emulated link", "-m", "tests.support.netem", *arguments)
        with ChildProcess(
            *command, stdin=PIPE, stdout=PIPE, stderr=PIPE, pass_fds=tuns, env=environment
        ) as forwarder:
            assert forwarder.stdin is not None
            link = EmulatedLink(sensing, display, _receive(forwarder)["began_ns"], forwarder.stdin)
            yield link
            forwarder.close_input()
            link.carried = ForwarderCounts(**_receive(forwarder))


def _receive(forwarder: ChildProcess) -> dict[str, int]:
    """Return the next table that the forwarder prints. Raises EmulatorError."""
    try:
        table: dict[str, int] = json.loads(forwarder.read_line(ANSWERS_WITHIN_S))
    except ProcessError as error:
        raise EmulatorError(str(error)) from None
    return table
