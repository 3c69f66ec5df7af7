"""Both nodes as processes that can be killed, stopped and restarted, with or without a link."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from subprocess import PIPE

import zmq

from protocol.config.scene_file import find_scene
from protocol.errors import ProcessError
from protocol.summary.fields import Summary
from protocol.wire.messages import decode_frame
from telepulse.processes import NodeProcess, free_addresses
from tests.support.altered_node import STEP
from tests.support.felt_force import POLL_MS, FeltForce, recording
from tests.support.netem import EmulatedLink
from tests.support.waiting import polled, until

PORT = 5555
STARTS_WITHIN_S = 30.0
ENDS_WITHIN_S = 20.0


class RigError(RuntimeError):
    """A node did not start, or the pulse was not felt."""


class Node(NodeProcess):
    """A node's process. listening_ns: when it printed its first line, on the monotonic clock."""

    listening_ns = 0

    def await_listening(self) -> None:
        """Wait for its first line."""
        try:
            self.read_line(STARTS_WITHIN_S, from_stderr=True)
        except ProcessError as error:
            raise RigError(str(error)) from None
        self.listening_ns = time.perf_counter_ns()

    def pause(self) -> None:
        self.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        self.send_signal(signal.SIGCONT)

    def step_clock(self) -> None:
        """Step its clock, where it was started with the alteration `step=SECONDS`."""
        self.send_signal(STEP)

    def end(self) -> Summary:
        self.terminate()
        return self.summary()

    def summary(self) -> Summary:
        return self.await_summary(ENDS_WITHIN_S)

    def rss_bytes(self) -> int:
        return rss_bytes(self.pid)


def rss_bytes(pid: int) -> int:
    pages = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


@dataclass
class NodeRig:
    """The place where nodes are started; link: between them, None for the loopback interface."""

    folder: Path
    stack: ExitStack
    link: EmulatedLink | None = None
    scene: Path = field(default_factory=lambda: find_scene("radial"))
    telemetry_address: str | None = None

    def __post_init__(self) -> None:
        self._nodes = 0
        if self.link is None:
            (self.bind,) = self.connect = free_addresses(1)
        else:
            self.bind = f"tcp://*:{PORT}"
            self.connect = [f"tcp://{address}:{PORT}" for address in self.link.sensing.addresses]

    def sense(self, alteration: str = "") -> Node:
        """Start a sensing node and wait until it listens; alteration: of `altered_node`."""
        return self._start("sensing node", "sensing_node.cli", alteration, "--bind", self.bind)

    def display(self, name: str = "display", alteration: str = "", *options: str) -> Node:
        """Start a display, which publishes telemetry at `telemetry(name)`."""
        connect = [option for address in self.connect for option in ("--connect", address)]
        more = ("--telemetry", self.telemetry(name), "--no-screen", "--once", *options)
        return self._start(name, "display_node.cli", alteration, *connect, *more)

    def play(self, alteration: str = "") -> tuple[Node, Node, FeltForce]:
        """Start both nodes and wait until the pulse is felt."""
        felt = self.felt()
        display, sensing = self.display(alteration=alteration), self.sense(alteration)
        if felt.first_ns(sensing.listening_ns, STARTS_WITHIN_S) is None:
            raise RigError(f"the pulse was not felt within {STARTS_WITHIN_S:g} s")
        return sensing, display, felt

    def await_played(self, felt: FeltForce, samples: int) -> None:
        """Wait until a display has played, or felt from a prediction, so many more samples."""

        def played() -> int:
            if felt.status is None:
                return 0
            counts = felt.status.summary["samples"]
            return int(counts["played"] + counts["predicted"])

        until(lambda: felt.status)
        wanted = played() + samples
        until(lambda: played() >= wanted, STARTS_WITHIN_S)

    def telemetry(self, name: str = "display") -> str:
        """Return a display's telemetry address: by default a file, which namespaces share."""
        return self.telemetry_address or f"ipc://{self.folder}/{name}"

    def felt(self, name: str = "display") -> FeltForce:
        """Record what is felt at a display from now on."""
        return self.stack.enter_context(recording(self.telemetry(name)))

    def _start(self, name: str, module: str, alteration: str, *arguments: str) -> Node:
        self._nodes += 1
        summary = self.folder / f"{self._nodes}.json"
        command = [module, str(self.scene), *arguments, "--insecure"]
        if alteration:
            command = ["tests.support.altered_node", alteration, *command]
        with ExitStack() as entered:
            if self.link is not None:
                sensing = module.startswith("sensing")
                namespace = self.link.sensing if sensing else self.link.display
                entered.enter_context(namespace.entered())
            node = Node(name, *command, summary=summary, stdout=PIPE, stderr=PIPE)
        self.stack.enter_context(node)
        node.await_listening()
        return node


def unaccounted(sensing: Summary, display: Summary) -> int:
    """Return the samples of one session that were sent and that no count of the display names."""
    sent, samples = sensing.samples.sent, display.samples
    counts = (samples.played, samples.predicted, samples.late, samples.lost)
    assert sent is not None
    return sent - sum(count or 0 for count in (*counts, samples.before_joining))


@contextmanager
def node_rig(
    folder: Path, link: EmulatedLink | None = None, scene: str = "radial"
) -> Iterator[NodeRig]:
    """Provide a rig whose nodes end with it; scene: name of a shipped one."""
    with ExitStack() as stack:
        yield NodeRig(folder, stack, link, find_scene(scene))


@contextmanager
def sequence_monitor(address: str) -> Iterator[dict[int, int]]:
    """Count the samples of each session published at an address, in order of the sessions.

    The counts also cover a node that was killed, which leaves no summary.
    """
    sent: dict[int, int] = {}
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.setsockopt(zmq.RECONNECT_IVL, POLL_MS)
        socket.subscribe(b"")
        socket.connect(address)

        def listen() -> None:
            if socket.poll(POLL_MS):
                frame = decode_frame(socket.recv())
                sent[frame.session] = frame.first_sample + len(frame.values)

        with polled(listen):
            yield sent
