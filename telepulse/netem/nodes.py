"""The two real nodes over emulated links, for tests and benchmarks."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from protocol.run_summary import Summary
from telepulse.netem.emulated_link import emulate
from telepulse.netem.forwarder import ForwarderCounts
from telepulse.netem.namespace import Namespace
from telepulse.processes import await_end, read_summary
from telepulse.simulation.link_model import LinkScene

PORT = 5555
# The display is listening before the pulse begins.
HEAD_START_S = 1.0
# From the pulse's end: a display that waits for what TCP repeats, and the slowest start of both.
ENDS_WITHIN_S = 20.0


@dataclass(frozen=True, slots=True)
class NodesOutcome:
    """Both nodes' summaries of a run, and what the link has carried."""

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

    The display has an address to connect to for each of `links`, which count, not the scene's.
    telemetry: where it publishes; ipc reaches out of its namespace. Raises EmulatorError or
    NodeError.
    """
    with (
        tempfile.TemporaryDirectory(prefix="telepulse-") as folder,
        emulate(*links, seed=seed) as emulated,
    ):
        sensing_json, display_json = Path(folder, "sensing.json"), Path(folder, "display.json")
        addresses = [f"tcp://{address}:{PORT}" for address in emulated.sensing.addresses]
        connect = [option for address in addresses for option in ("--connect", address)]
        common = (str(path), "--quiet", "--insecure", "--json")
        listen = (*connect, "--once", "--telemetry", telemetry)
        listen += ("--seconds", str(seconds + ENDS_WITHIN_S))
        send = ("--bind", f"tcp://*:{PORT}", "--seconds", str(seconds))
        with _node(
            emulated.display, "display_node", *common, str(display_json), *listen
        ) as display:
            time.sleep(HEAD_START_S)
            with _node(
                emulated.sensing, "sensing_node", *common, str(sensing_json), *send
            ) as sensing:
                await_end(sensing, "sensing node", seconds + ENDS_WITHIN_S)
                await_end(display, "display node", ENDS_WITHIN_S)
        sensed, played = read_summary(sensing_json), read_summary(display_json)
    return NodesOutcome(sensed, played, emulated.carried)


@contextmanager
def _node(namespace: Namespace, package: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A node in a namespace that does not outlive the `with`."""
    command = (sys.executable, "-m", f"{package}.cli", *arguments)
    process = namespace.start(*command, stderr=subprocess.PIPE)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()
