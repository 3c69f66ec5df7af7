"""A run of both real nodes over emulated links, with the processor time of each."""

import os
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from protocol.summary.fields import Summary
from telepulse.simulation.link_scene import LinkScene
from tests.support.netem import emulate
from tests.support.netem.forwarder import ForwarderCounts
from tests.support.node_rig import node_rig

# Not part of the measured processor time: the first seconds of a stream.
STARTS_WITHIN_S = 4.0

MeasuredWithin = Callable[[Sequence[int]], AbstractContextManager[None]]


@dataclass(frozen=True, slots=True)
class NodesOutcome:
    """The display's summary of a run, and the counts of the links.

    sensing_cpu, display_cpu: processor time of each node over that of the stream.
    """

    display: Summary
    carried: ForwarderCounts
    sensing_cpu: float
    display_cpu: float


def run_nodes(
    scene: Path,
    *links: LinkScene,
    seconds: float,
    measured: MeasuredWithin = lambda _: nullcontext(),
) -> NodesOutcome:
    """Run both nodes with a scene, a namespace each, for some seconds, more than four.

    The display connects to an address on each of `links`, which replace the scene's link.
    measured: makes, from the processes' ids, a context for the measured time. Raises EmulatorError
    or RigError.
    """
    with (
        TemporaryDirectory(prefix="telepulse-") as folder,
        emulate(*links) as emulated,
        node_rig(Path(folder), emulated) as rig,
    ):
        rig.scene = scene
        display, sensing = rig.display(), rig.sense()
        pids = (sensing.pid, display.pid)
        time.sleep(STARTS_WITHIN_S)
        with measured(pids):
            before_s, began_s = [cpu_time_s(pid) for pid in pids], time.monotonic()
            time.sleep(seconds - STARTS_WITHIN_S)
            after_s, passed_s = [cpu_time_s(pid) for pid in pids], time.monotonic() - began_s
        sensing.end()
        played = display.summary()
    assert emulated.carried is not None
    shares = [(after - before) / passed_s for before, after in zip(before_s, after_s, strict=True)]
    return NodesOutcome(played, emulated.carried, *shares)


def cpu_time_s(pid: int) -> float:
    """Return the processor time that all threads of a process have used. Linux."""
    # The name, in parentheses, may contain spaces; times in user and system mode are 11 and 12
    # fields after it.
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
