"""Redundant paths: one-way delay over real TCP on a lossy link, by the number of connections.

Needs root, for the link emulator.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.measure import show
from protocol.summary import Summary
from telepulse.emulator import run_nodes, unavailable
from telepulse.link import parse_link
from telepulse.scene import find_scene, load_scene
from telepulse.simulate import simulate

SECONDS = 30.0
LOSS_FREE = "delay=20ms,jitter=3ms"
LOSSY = LOSS_FREE + ",loss=1%"
BAR = 1.1
CONGESTION_CONTROL = Path("/proc/sys/net/ipv4/tcp_congestion_control")


def main() -> None:
    """Print the table; the bar is a p99 of at most 1.1 times the loss-free one, nothing lost."""
    reason = unavailable()
    if reason is not None:
        print(f"paths: left out: {reason}")
        return
    with TemporaryDirectory(prefix="telepulse-") as folder:
        runs = [
            (name, paths, play(Path(folder), link, paths))
            for name, link, paths in (
                ("loss-free", LOSS_FREE, 1),
                ("1 % loss", LOSSY, 1),
                ("1 % loss", LOSSY, 2),
                ("1 % loss", LOSSY, 3),
            )
        ]
        runs.insert(2, ("simulated", 1, simulated(Path(folder))))
    base_ms = runs[0][2].one_way_delay_ms.p99
    control = CONGESTION_CONTROL.read_text(encoding="ascii").strip()
    show(
        f"Paths at 20±3 ms, 10 ms frames, {SECONDS:g} s each, TCP's {control}: one-way delay in ms;"
        f" the bar for 3 is {BAR} times the loss-free p99, and none lost",
        ("link", "paths", "p50", "p99", "max", "over first", "sent", "played", "late", "lost"),
        [row(*run, base_ms or 0.0) for run in runs],
    )


def row(name: str, paths: int, summary: Summary, base_ms: float) -> tuple[str, ...]:
    """A run as it stands in the table; base_ms: the loss-free p99."""
    delay_ms, samples = summary.one_way_delay_ms, summary.samples
    p99_ms = delay_ms.p99 or 0.0
    delays_ms = (delay_ms.p50 or 0.0, p99_ms, delay_ms.max or 0.0)
    counts = (samples.sent, samples.played, samples.late, samples.lost)
    return (
        name,
        str(paths),
        *(f"{value:.1f}" for value in delays_ms),
        f"{p99_ms / base_ms:.2f}",
        *map(str, counts),
    )


def play(folder: Path, link: str, paths: int) -> Summary:
    """The display's summary over real TCP."""
    return run_nodes(scene_of(folder, paths), parse_link(link), SECONDS).display


def simulated(folder: Path) -> Summary:
    """What the model of TCP says of one path with loss."""
    scene = load_scene(scene_of(folder, paths=1))
    link = parse_link(LOSSY + ",transport=tcp")
    return simulate(replace(scene, link=link), SECONDS, seed=1)


def scene_of(folder: Path, paths: int) -> Path:
    """The default scene in frames of 10 ms over so many paths."""
    text = find_scene("radial").read_text(encoding="utf-8")
    text = text.replace('batch = "5 ms"', 'batch = "10 ms"')
    scene = folder / f"{paths}.toml"
    scene.write_text(text.replace("[display]\n", f"[display]\npaths = {paths}\n"), "utf-8")
    return scene
