"""The nodes of a soak: a sensing node under faults with its displays, and a calm pair."""

from dataclasses import dataclass, field
from pathlib import Path

from protocol.errors import ProcessError
from protocol.host.child_process import ChildProcess
from soak.network import Network
from soak.processes import SoakProcess, begin
from soak.schedule import CONTINUOUS, RESTARTED, SENSING, TEMPORARY
from telepulse.processes import free_addresses
from tests.support.keyring import Keyring

CALM_SENSING, CALM_DISPLAY = "calm sensing", "calm display"
DISTURBED = (CONTINUOUS, RESTARTED, TEMPORARY)
UNPROTECTED = ("--insecure",)
# The links to each of the disturbed displays.
LINKS = {CONTINUOUS: (0, 1), RESTARTED: (2,), TEMPORARY: (3,)}


@dataclass(slots=True)
class Scenario:
    """The nodes of a soak.

    nodes: the latest node of each role. all_nodes: all nodes in order of their start. complaints:
    failures that the soak did not cause. longest_s: time after which nodes end by themselves, if
    the soak is killed. keys: None for nodes without keys. options: options of all nodes.
    """

    network: Network
    scene: Path
    folder: Path
    longest_s: float
    keys: Keyring | None
    options: tuple[str, ...] = ()
    nodes: dict[str, SoakProcess] = field(default_factory=dict)
    all_nodes: list[SoakProcess] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    intruders: list[ChildProcess] = field(default_factory=list)
    calm_address: str = field(default_factory=lambda: free_addresses(1)[0])

    def telemetry(self, role: str) -> str:
        """Return a display's telemetry address, a file, which is shared between namespaces."""
        return f"ipc://{self.folder}/{role.replace(' ', '-')}"

    def start(self, role: str) -> SoakProcess:
        """Start the node of a role."""
        network, disturbed = self.network, role not in (CALM_SENSING, CALM_DISPLAY)
        if role in (SENSING, CALM_SENSING):
            module, namespace = "sensing_node.cli", network.sensing if disturbed else None
            bind = network.bind if disturbed else self.calm_address
            arguments = ["--bind", bind]
            key = ["--key", self.keys.path("wrist")] if self.keys else []
        else:
            module, namespace = "display_node.cli", network.display if disturbed else None
            addresses = [self.calm_address]
            if disturbed:
                addresses = [network.addresses[number] for number in LINKS[role]]
            connect = [option for address in addresses for option in ("--connect", address)]
            telemetry = ("--telemetry", self.telemetry(role))
            arguments = [*connect, *telemetry, "--no-screen"]
            key = ["--key", self.keys.path("finger")] if self.keys else []
            key += ["--peer", self.keys.path("wrist", "pub")] if self.keys else []
        number = len(self.all_nodes)
        arguments += [*(key or UNPROTECTED), *self.options, "--seconds", str(self.longest_s)]
        node = begin(role, self.folder, number, namespace, module, str(self.scene), *arguments)
        self.nodes[role] = node
        self.all_nodes.append(node)
        return node

    def refuse_dead(self) -> None:
        """Raise ProcessError for a node that did not start."""
        for node in self.nodes.values():
            if not node.running:
                raise ProcessError(str(node.complaint()))

    def start_intruder(self, kind: str, *arguments: str) -> ChildProcess:
        """Start a hostile process beside the sensing node."""
        command = ("-m", "soak.intruder", kind, *arguments)
        errors_path = self.folder / f"{kind}.err"
        with errors_path.open("ab") as errors, self.network.sensing.entered():
            self.intruders.append(ChildProcess(kind, *command, stdout=errors, stderr=errors))
        return self.intruders[-1]

    def stop_intruder(self, intruder: ChildProcess) -> None:
        """End a hostile process."""
        if intruder.poll() is not None:
            self.complaints.append(f"{intruder.name} ended by itself")
        intruder.kill()
        intruder.wait()

    def clear(self) -> None:
        """End all processes, however the soak ended."""
        for process in [*self.intruders, *(node.process for node in self.all_nodes)]:
            process.kill()
            process.wait()
