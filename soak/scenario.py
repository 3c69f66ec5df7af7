"""The nodes of a soak: a sensing node under faults with its displays, and a calm pair."""

from dataclasses import dataclass, field
from pathlib import Path

from protocol.errors import ProcessError
from protocol.host.child_process import ChildProcess
from soak.keyring import Keyring
from soak.network import Network
from soak.processes import SoakProcess, begin, launch
from soak.schedule import ENDURING, GUEST, MORTAL, SENSING
from telepulse.processes import free_addresses

CALM_SENSING, CALM_DISPLAY = "calm sensing", "calm display"
TORMENTED = (ENDURING, MORTAL, GUEST)
UNPROTECTED = ("--insecure",)
# The links that lead to each of the tormented displays.
LINKS = {ENDURING: (0, 1), MORTAL: (2,), GUEST: (3,)}


@dataclass(slots=True)
class Scenario:
    """lives: the latest of each role. all_lives: all of them, in the order of their begin.
    complaints: what has gone wrong that is no fault of ours. longest_s: when nodes end by
    themselves, should we be killed ourselves. keys: None for nodes without any. options: of all
    nodes.
    """

    network: Network
    scene: Path
    folder: Path
    longest_s: float
    keys: Keyring | None
    options: tuple[str, ...] = ()
    lives: dict[str, SoakProcess] = field(default_factory=dict)
    all_lives: list[SoakProcess] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    pests: list[ChildProcess] = field(default_factory=list)
    calm_address: str = field(default_factory=lambda: free_addresses(1)[0])

    def telemetry(self, role: str) -> str:
        """Where a display publishes; it reaches out of its namespace."""
        return f"ipc://{self.folder}/{role.replace(' ', '-')}"

    def start(self, role: str) -> SoakProcess:
        """Start the node of a role."""
        network, tormented = self.network, role not in (CALM_SENSING, CALM_DISPLAY)
        if role in (SENSING, CALM_SENSING):
            module, namespace = "sensing_node.cli", network.sensing if tormented else None
            bind = network.bind if tormented else self.calm_address
            arguments = ["--bind", bind]
            protection = self.keys.sensing if self.keys else UNPROTECTED
        else:
            module, namespace = "display_node.cli", network.display if tormented else None
            addresses = [self.calm_address]
            if tormented:
                addresses = [network.addresses[number] for number in LINKS[role]]
            connect = [option for address in addresses for option in ("--connect", address)]
            telemetry = ("--telemetry", self.telemetry(role))
            arguments = [*connect, *telemetry, "--no-screen"]
            protection = self.keys.display if self.keys else UNPROTECTED
        number = len(self.all_lives)
        arguments += [*protection, *self.options, "--seconds", str(self.longest_s)]
        life = begin(role, self.folder, number, namespace, module, str(self.scene), *arguments)
        self.lives[role] = life
        self.all_lives.append(life)
        return life

    def refuse_dead(self) -> None:
        """Raises ProcessError for a node that did not come up."""
        for life in self.lives.values():
            if not life.running:
                raise ProcessError(str(life.complaint()))

    def pester(self, module: str, *arguments: str) -> ChildProcess:
        """Start something beside the sensing node that its displays should not meet."""
        command = ("-m", f"soak.{module}", *arguments)
        with (self.folder / f"{module}.err").open("ab") as errors:
            self.pests.append(launch(self.network.sensing, module, command, errors, errors))
        return self.pests[-1]

    def relieve(self, pest: ChildProcess) -> None:
        """End such a thing."""
        if pest.poll() is not None:
            self.complaints.append(f"{pest.name} ended by itself")
        pest.kill()
        pest.wait()

    def clear(self) -> None:
        """Leave no process behind, however the soak ends."""
        for process in [*self.pests, *(life.process for life in self.all_lives)]:
            process.kill()
            process.wait()
