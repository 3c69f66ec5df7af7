"""Cost of a peer's flood for the other node.

A hostile sensing node sends each frame, or each control answer, hundreds of times; a hostile
display sends clock requests as fast as it can. Both have the rights of an allowed peer.
"""

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.benchmark import Benchmark
from benchmarks.faults.own_time import own_time_of, pin
from benchmarks.timing import median_quantile
from protocol.summary.fields import Summary
from telepulse.scene import load_scene
from tests.support.hostile_peers import flood_with_requests
from tests.support.node_rig import RigError, node_rig

FLOODED_S = 8.0
PATIENCE_S = 30.0
# Under a flood the pulse may never be felt.
HOSTILE_WAIT_S = 4.0


@dataclass(frozen=True, slots=True)
class FloodRun:
    """Both nodes' summaries, and the share of the display's ticks that were missed.

    own_missed: the share missed by the display's own core time.
    """

    sensing: Summary
    display: Summary
    missed: float
    own_missed: float


def run(alteration: str, flood: Callable[[str], object]) -> FloodRun:
    """Run both nodes, the display on a processor of its own.

    alteration: alteration of the sensing node. flood: called with the sensing node's address while
    the nodes run.
    """
    first, *others = sorted(os.sched_getaffinity(0))
    with TemporaryDirectory(prefix="telepulse-") as folder, node_rig(Path(folder)) as rig:
        felt = rig.felt()
        display = rig.display("display")
        sensing = rig.sense(alteration)
        # Every other process, this one included, shares the remaining processors.
        pin(display.pid, first)
        for pid in (os.getpid(), sensing.pid):
            pin(pid, others[0] if others else first)
        try:
            with own_time_of(display.pid) as own:
                wait_s = HOSTILE_WAIT_S if alteration else PATIENCE_S
                if felt.first_ns(0, wait_s) is None and not alteration:
                    raise RigError("the pulse was not felt")
                flood(rig.connect[0])
            summary, sent = display.end(), sensing.end()
        finally:
            os.sched_setaffinity(0, {first, *others})
        tick_ns = load_scene(rig.scene).display.tick_ns
        missed, own_missed = own.own_misses(felt, tick_ns)
    ticks = max(1, (summary.loop.ticks or 0) + missed)
    return FloodRun(sent, summary, missed / ticks, own_missed / ticks)


def floods(benchmark: Benchmark) -> None:
    """Flood a display with frames, with answers, and a sensing node with requests."""
    seconds = 1.0 if benchmark.quick else FLOODED_S
    found = {}
    for name, alteration in (("none", ""), ("frames", "flood=data"), ("answers", "flood=control")):
        found[f"display: flood of {name}"] = run(alteration, lambda _: time.sleep(seconds))
    counts: list[int] = []
    flooded = run("", lambda at: counts.append(flood_with_requests(at, seconds)))
    name = f"display beside one that sends {counts[0] / seconds:.0f} requests/s"
    found[name] = flooded
    rows = [(name, *_figures(each)) for name, each in found.items()]
    benchmark.judge(
        "ticks missed by the display's own core time in a flood",
        max(each.own_missed for each in found.values()),
    )
    benchmark.table(
        f"{seconds:g} s of a flood: missed ticks, and those missed by the display's own core time;"
        " share of the samples played in time, what was refused",
        ("flood", "missed", "own", "tick p99 µs", "in time", "p99 delay ms", "refused"),
        rows,
    )
    print("sensing node refused", flooded.sensing.rejected)


def _figures(flooded: FloodRun) -> tuple[str, ...]:
    display = flooded.display
    samples = display.samples
    played = "–" if not samples.sent else f"{100 * (samples.played or 0) / samples.sent:.1f} %"
    causes = ", ".join(f"{count} {cause}" for cause, count in display.rejected.items())
    return (
        f"{100 * flooded.missed:.1f} %",
        f"{100 * flooded.own_missed:.1f} %",
        median_quantile("p99", [display.loop.tick_us]),
        played,
        median_quantile("p99", [display.one_way_delay_ms], 1),
        causes or "nothing",
    )
