"""Redundant paths: one-way delay on a lossy link, and the effect of a cut.

The delay is over real TCP, by the number of connections; the cut by the number of networks. Needs
root, for the link emulator.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.benchmark import Benchmark
from benchmarks.nodes import NodesOutcome, run_nodes
from benchmarks.timing import median_quantile
from protocol.config.scene_file import find_scene
from protocol.histogram import bound
from protocol.summary.fields import Summary
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation
from tests.support.netem import unavailable

SECONDS, QUICK_S = 30.0, 8.0
LOSS_FREE = "delay=20ms,jitter=3ms"
LOSSY = LOSS_FREE + ",loss=1%"
# Times count from the link's start, before the nodes'.
CUT = LOSS_FREE + ",cut.from=10s,cut.for=5s"
CUT_FOR_GOOD = LOSS_FREE + ",cut.from=10s,cut.for=60min"
CONGESTION_CONTROL = Path("/proc/sys/net/ipv4/tcp_congestion_control")


def main(benchmark: Benchmark) -> None:
    """Print the tables."""
    reason = unavailable()
    if reason is not None:
        print(f"paths: left out: {reason}")
        return
    seconds = QUICK_S if benchmark.quick else SECONDS
    losses = ("0 %",) if benchmark.quick else ("0 %", "1 %", "3 %")
    cut_links: dict[str, tuple[str, ...]] = {
        "no cut": (LOSS_FREE,),
        "5 s cut": (CUT,),
        "5 s cut of the first": (CUT, LOSS_FREE),
        "cut of the first for good": (CUT_FOR_GOOD, LOSS_FREE),
    }
    cut_names = list(cut_links)[:1] if benchmark.quick else list(cut_links)
    with TemporaryDirectory(prefix="telepulse-") as folder:
        scenes = {paths: scene_of(Path(folder), paths) for paths in (1, 2, 3)}

        def play(paths: int, *links: str) -> NodesOutcome:
            return run_nodes(scenes[paths], *map(parse_link, links), seconds=seconds)

        runs = [
            (loss, paths, play(paths, f"{LOSS_FREE},loss={loss.replace(' ', '')}"))
            for loss in losses
            for paths in (1, 3, *((2,) if loss != "0 %" else ()))
        ]
        simulated = replace(load_scene(scenes[1]), link=parse_link(LOSSY + ",transport=tcp"))
        model = Simulation(simulated, 1).run(seconds)
        cuts = [
            cut_row(name, cut_links[name], play(1, *cut_links[name]).display) for name in cut_names
        ]
    three = [run.display for _, paths, run in runs if paths == 3]
    base_ms = runs[0][2].display.one_way_delay_ms.p99 or 0.0
    worst_ms = max(each.one_way_delay_ms.p99 or math.inf for each in three)
    benchmark.judge("p99 of three connections over that without loss", worst_ms / base_ms)
    benchmark.judge("samples lost over three", sum(each.samples.lost or 0 for each in three))
    control = CONGESTION_CONTROL.read_text(encoding="ascii").strip()
    benchmark.table(
        f"Paths at 20±3 ms, 10 ms frames, {seconds:g} s each, TCP's {control}: one-way delay in ms",
        ("loss", "paths", "p50", "p99", "max", "over first", "mean E", "lost"),
        [
            *(row(loss, paths, run.display, base_ms) for loss, paths, run in runs),
            row("1 %, simulated", 1, model, base_ms),
        ],
    )
    benchmark.table(
        "Cost of the same runs, in both directions with acknowledgements, control and IP headers:"
        " traffic, and processor time in % of a core",
        ("loss", "paths", "packets/s", "kB/s", "sensing node", "display node"),
        [cost_row(*run, seconds) for run in runs],
    )
    benchmark.table(
        f"Networks at 20±3 ms, a path each, {seconds:g} s: what is felt of a cut, in ms",
        ("cut", "networks", "mean E", "longest delay", "later by", "late", "lost", "first copies"),
        cuts,
    )


def row(loss: str, paths: int, summary: Summary, base_ms: float) -> tuple[str, ...]:
    """Return the row of a run; base_ms: the loss-free p99 of one connection."""
    delay_ms = summary.one_way_delay_ms
    return (
        loss,
        str(paths),
        *(median_quantile(key, [delay_ms], 1) for key in ("p50", "p99")),
        f"{delay_ms.max or 0.0:.1f}",
        f"{bound('p99', delay_ms.beyond)}{(delay_ms.p99 or 0.0) / base_ms:.2f}",
        f"{summary.playout_delay_ms.mean or 0.0:.1f}",
        str(summary.samples.lost),
    )


def cost_row(loss: str, paths: int, run: NodesOutcome, seconds: float) -> tuple[str, ...]:
    """Return what a run cost the network and both nodes."""
    carried = run.carried
    return (
        loss,
        str(paths),
        f"{carried.packets / seconds:.0f}",
        f"{carried.bytes / seconds / 1e3:.1f}",
        *(f"{100 * share:.1f}" for share in (run.sensing_cpu, run.display_cpu)),
    )


def cut_row(name: str, links: Sequence[str], summary: Summary) -> tuple[str, ...]:
    """Return the row of a run with a cut."""
    mean_ms, longest_ms = summary.playout_delay_ms.mean or 0.0, summary.one_way_delay_ms.max or 0.0
    figures_ms = (mean_ms, longest_ms, max(0.0, longest_ms - mean_ms))
    first = summary.frames.first.values() or (summary.frames.received,)
    return (
        name,
        str(len(links)),
        *(f"{value:.1f}" for value in figures_ms),
        *map(str, (summary.samples.late, summary.samples.lost)),
        " + ".join(map(str, first)),
    )


def scene_of(folder: Path, paths: int) -> Path:
    """Return the default scene with frames of 10 ms and this number of paths."""
    text = find_scene("radial").read_text(encoding="utf-8")
    text = text.replace('batch = "5 ms"', 'batch = "10 ms"')
    scene = folder / f"{paths}.toml"
    scene.write_text(text.replace("[display]\n", f"[display]\npaths = {paths}\n"), "utf-8")
    return scene
