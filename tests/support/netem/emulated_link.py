"""Two namespaces and the emulated links between them, and runs of the two real nodes over them."""

import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from subprocess import PIPE
from typing import IO

from protocol.errors import ProcessError
from protocol.host.child_process import ChildProcess
from protocol.summary.tables import Summary
from telepulse.processes import NodeProcess, cpu_time_s
from telepulse.simulation.link_scene import LinkScene
from tests.support.netem.forwarder import DROP, ForwarderCounts, PacketFilter
from tests.support.netem.namespace import EmulatorError, Namespace

ROOT = Path(__file__).resolve().parents[3]
# Addresses inside the two namespaces, with one network for each link.
SENSING_ADDRESS, DISPLAY_ADDRESS = "10.77.{}.1", "10.77.{}.2"
ANSWERS_WITHIN_S = 30.0
PORT = 5555
# The display has connected before the pulse begins.
HEAD_START_S = 1.0
# Not part of the measured processor time: the first and the last seconds of a stream.
STARTS_WITHIN_S, ENDS_AFTER_S = 4.0, 1.0
# Time after the pulse for TCP's retransmissions, and for the slowest start of both nodes.
ENDS_WITHIN_S = 20.0


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


MeasuredWithin = Callable[[Sequence[int]], AbstractContextManager[None]]


@dataclass(frozen=True, slots=True)
class NodesOutcome:
    """Both nodes' summaries of a run, and the counts of the links.

    sensing_cpu, display_cpu: processor time of each node over that of the middle of the stream;
    None for a stream that is too short.
    """

    sensing: Summary
    display: Summary
    carried: ForwarderCounts | None
    sensing_cpu: float | None = None
    display_cpu: float | None = None


def run_nodes(
    path: Path,
    *links: LinkScene,
    seconds: float,
    seed: int = 1,
    telemetry: str = "tcp://127.0.0.1:*",
    measured: MeasuredWithin = lambda _: nullcontext(),
) -> NodesOutcome:
    """Run both nodes with the scene at `path`, a namespace each, for `seconds` of pulse.

    The display connects to an address on each of `links`, which replace the scene's link.
    telemetry: address to publish on; ipc is reachable from outside the namespace. measured: makes,
    from the processes' ids, a context for the middle of the stream. Raises EmulatorError or
    ProcessError.
    """
    with (
        tempfile.TemporaryDirectory(prefix="telepulse-") as folder,
        emulate(*links, seed=seed) as emulated,
    ):
        addresses = [f"tcp://{address}:{PORT}" for address in emulated.sensing.addresses]
        connect = [option for address in addresses for option in ("--connect", address)]
        common = (str(path), "--quiet", "--insecure", "--seconds")
        with emulated.display.entered():
            display = NodeProcess(
                *("display node", "display_node.cli", *common, str(seconds + ENDS_WITHIN_S)),
                *(*connect, "--once", "--telemetry", telemetry),
                summary=Path(folder, "display.json"),
                stderr=PIPE,
            )
        with display:
            time.sleep(HEAD_START_S)
            with emulated.sensing.entered():
                sensing = NodeProcess(
                    *("sensing node", "sensing_node.cli", *common, str(seconds)),
                    *("--bind", f"tcp://*:{PORT}"),
                    summary=Path(folder, "sensing.json"),
                    stderr=PIPE,
                )
            with sensing:
                shares = _cpu_shares([sensing.pid, display.pid], seconds, measured)
                sensed = sensing.await_summary(seconds + ENDS_WITHIN_S)
                played = display.await_summary(ENDS_WITHIN_S)
    return NodesOutcome(sensed, played, emulated.carried, *shares)


def _cpu_shares(
    pids: Sequence[int], seconds: float, measured: MeasuredWithin
) -> list[float | None]:
    """Measure the share of a core that each process uses in the middle of the stream.

    Start and end of the processes are left out. Returns None for each if too little is left.
    """
    measured_s = seconds - STARTS_WITHIN_S - ENDS_AFTER_S
    if measured_s <= 0:
        return [None] * len(pids)
    time.sleep(STARTS_WITHIN_S)
    with measured(pids):
        before_s, began_s = [cpu_time_s(pid) for pid in pids], time.monotonic()
        time.sleep(measured_s)
        passed_s = time.monotonic() - began_s
        after_s = [cpu_time_s(pid) for pid in pids]
    return [(after - before) / passed_s for before, after in zip(before_s, after_s, strict=True)]
