"""Both nodes as processes that can be killed, stopped and started again, on a link or on none."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from subprocess import PIPE

from benchmarks.faults.finger import Finger, finger_of
from benchmarks.faults.stepped import STEP
from protocol.config.scene_file import find_scene
from protocol.errors import ProcessError
from protocol.run_summary import Summary
from telepulse.netem import EmulatedLink
from telepulse.processes import NodeProcess, free_addresses

PORT = 5555
STARTS_WITHIN_S = 30.0
ENDS_WITHIN_S = 20.0
LOOK_AGAIN_S = 0.02


class StageError(RuntimeError):
    """A node did not do its part."""


@dataclass
class Node:
    """A node's process. listening_ns: when it printed its first line, on the monotonic clock."""

    name: str
    process: NodeProcess
    listening_ns: int = 0

    def await_listening(self) -> None:
        """Wait for its first line. Raises StageError."""
        try:
            self.process.read_line(STARTS_WITHIN_S, log=True)
        except ProcessError as error:
            raise StageError(str(error)) from None
        self.listening_ns = time.monotonic_ns()

    def kill(self) -> None:
        """As `kill -9`."""
        self.process.kill()
        self.process.communicate()

    def pause(self) -> None:
        """It does nothing any more, and is not gone."""
        self.process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """It goes on."""
        self.process.send_signal(signal.SIGCONT)

    def step_clock(self) -> None:
        """Its clock steps, if it was started to."""
        self.process.send_signal(STEP)

    def end(self) -> Summary:
        """Ask a sensing node to end; its account. Raises ProcessError."""
        self.process.terminate()
        return self.account()

    def account(self) -> Summary:
        """Its account, once it has ended, as a display does by itself at the end of the stream.
        Raises ProcessError.
        """
        return self.process.await_summary(ENDS_WITHIN_S)

    def rss_bytes(self) -> int:
        """Memory that it holds."""
        pages = Path(f"/proc/{self.process.pid}/statm").read_text(encoding="ascii").split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")


@dataclass
class Stage:
    """Where nodes are started; link: between the two of them, None for this machine alone."""

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

    def sense(self, stepped: bool = False) -> Node:
        """Start a sensing node; it is listening when this returns. Raises StageError."""
        return self._start("sensing node", "sensing_node.cli", stepped, "--bind", self.bind)

    def display(self, name: str = "display", stepped: bool = False) -> Node:
        """Start a display; its telemetry is at `telemetry(name)`. Raises StageError."""
        connect = [option for address in self.connect for option in ("--connect", address)]
        more = ("--telemetry", self.telemetry(name), "--no-screen", "--once")
        return self._start(name, "display_node.cli", stepped, *connect, *more)

    def play(self, stepped: bool = False) -> tuple[Node, Node, Finger]:
        """Start both nodes; the pulse is felt when this returns. stepped: their clocks can step.
        Raises StageError.
        """
        finger = self.finger()
        display, sensing = self.display(stepped=stepped), self.sense(stepped)
        if finger.felt_from_ns(sensing.listening_ns, STARTS_WITHIN_S) is None:
            raise StageError(f"the pulse was not felt within {STARTS_WITHIN_S:g} s")
        return sensing, display, finger

    def await_played(self, finger: Finger, samples: int) -> None:
        """Wait until a display has played so many more. Raises StageError."""
        counts: list[int] = []
        end_s = time.monotonic() + STARTS_WITHIN_S
        while not counts or counts[-1] < counts[0] + samples:
            if time.monotonic() > end_s:
                raise StageError(f"no {samples} samples were played in {STARTS_WITHIN_S:g} s")
            if finger.status is not None:
                counts.append(finger.status.summary["samples"]["played"])
            time.sleep(LOOK_AGAIN_S)

    def telemetry(self, name: str = "display") -> str:
        """Where a display publishes; a file, if nothing else is said: it reaches out of a
        namespace.
        """
        return self.telemetry_address or f"ipc://{self.folder}/{name}"

    def finger(self, name: str = "display") -> Finger:
        """What is felt at the display of this name, from now to the end."""
        return self.stack.enter_context(finger_of(self.telemetry(name)))

    def _start(self, name: str, module: str, stepped: bool, *arguments: str) -> Node:
        self._nodes += 1
        summary = self.folder / f"{self._nodes}.json"
        command = ["benchmarks.faults.stepped"] * stepped + [module, str(self.scene), *arguments]
        with ExitStack() as entered:
            if self.link is not None:
                sensing = module.startswith("sensing")
                namespace = self.link.sensing if sensing else self.link.display
                entered.enter_context(namespace.entered())
            process = NodeProcess(
                name, *command, "--insecure", summary=summary, stdout=PIPE, stderr=PIPE
            )
        node = Node(name, self.stack.enter_context(process))
        node.await_listening()
        return node


def unaccounted(sensing: Summary, display: Summary) -> int:
    """Samples of one session that were sent, and that the display has no account of."""
    sent, samples = sensing.samples.sent, display.samples
    counts = (samples.played, samples.late, samples.lost, samples.before_joining)
    assert sent is not None
    return sent - sum(count or 0 for count in counts)


@contextmanager
def staged(folder: Path, link: EmulatedLink | None = None) -> Iterator[Stage]:
    """A stage whose nodes do not outlive the `with`."""
    with ExitStack() as stack:
        yield Stage(folder, stack, link)
