"""Runs of the two real nodes over emulated links, for tests and benchmarks."""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from subprocess import PIPE

from protocol.run_summary import Summary
from telepulse.netem.emulated_link import emulate
from telepulse.netem.forwarder import ForwarderCounts
from telepulse.processes import NodeProcess
from telepulse.simulation.link_model import LinkScene

PORT = 5555
# The display has connected before the pulse begins.
HEAD_START_S = 1.0
# Time after the pulse for TCP's retransmissions, and for the slowest start of both nodes.
ENDS_WITHIN_S = 20.0


@dataclass(frozen=True, slots=True)
class NodesOutcome:
    """Both nodes' summaries of a run, and the counts of the links."""

    sensing: Summary
    display: Summary
    carried: ForwarderCounts | None


def run_nodes(
    path: Path,
    *links: LinkScene,
    seconds: float,
    seed: int = 1,
    telemetry: str = "tcp://127.0.0.1:*",
) -> NodesOutcome:
    """Run both nodes with the scene at `path`, a namespace each, for `seconds` of pulse.

    The display connects to an address on each of `links`, which replace the scene's link.
    telemetry: address to publish on; ipc is reachable from outside the namespace. Raises
    EmulatorError or ProcessError.
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
                sensed = sensing.await_summary(seconds + ENDS_WITHIN_S)
                played = display.await_summary(ENDS_WITHIN_S)
    return NodesOutcome(sensed, played, emulated.carried)
