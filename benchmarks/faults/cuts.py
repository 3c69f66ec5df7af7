"""Kinds of cuts, many times each, and how often a display reconnects where nothing is cut.

One pair of nodes serves all cuts of a kind: fifty take some three minutes. Each cut begins at a
random instant. The time counts from its end until the pulse is felt again at full strength for at
least 0.3 s. Needs root, for the link emulator.
"""

import random
import statistics
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.benchmark import Benchmark
from protocol.config.scene_file import find_scene
from telepulse.simulation.link_scene import LinkScene, parse_link
from tests.support.felt_force import FeltForce
from tests.support.netem import EmulatedLink, PacketFilter, emulate
from tests.support.node_rig import PORT, Node, node_rig

WHOLE_TEXT = "20±3 ms"
WHOLE = parse_link("delay=20ms,jitter=3ms")
TIMES = 50
SEED = 1
BAR_MS = 1e3
# A lossy link or a stopped node must not make a display reconnect again and again.
WATCHED_S = 30.0
LOSSY = ("loss=0%", "loss=5%", "loss=20%")
# Between two cuts TCP and the delay estimate settle, and the phase becomes random.
BETWEEN_S = (0.7, 1.5)
BACK_WITHIN_S = 20.0
SHORT_S, LONG_S = (0.1, 0.6), (0.6, 3.0)

# Cuts in quick succession are jitter to a display: after a few, a longer playout delay would cover
# them. This scene's covers only the shorter half of all delays.
LATE_TARGET = 'late_target = "50 %"'

DATA, CONTROL = PacketFilter(port=PORT), PacketFilter(port=PORT + 1)
ALL = PacketFilter()
TO_DISPLAY, TO_SENSING = PacketFilter(towards="display"), PacketFilter(towards="sensing")
SYN = PacketFilter(syn_only=True)


@dataclass(frozen=True, slots=True)
class Cut:
    """One kind of cut: for each of its phases the filters and the range of its length in s."""

    phases: Sequence[tuple[Sequence[PacketFilter], tuple[tuple[float, float], ...]]]


# Two of three cuts are short.
MIXED = (SHORT_S, SHORT_S, LONG_S)
KINDS: dict[str, Cut] = {
    "both ports, 0.1 to 0.6 s": Cut([([ALL], (SHORT_S,))]),
    "both ports, 0.6 to 3 s": Cut([([ALL], (LONG_S,))]),
    "data port alone": Cut([([DATA], MIXED)]),
    "control port alone": Cut([([CONTROL], MIXED)]),
    "towards the display alone": Cut([([TO_DISPLAY], MIXED)]),
    "towards the sensing node alone": Cut([([TO_SENSING], MIXED)]),
    "both ports, then requests to connect": Cut([([ALL], MIXED), ([SYN], MIXED)]),
}


@dataclass(frozen=True, slots=True)
class Recovery:
    """Length of one cut, and time from its end until the pulse was felt again, in ms."""

    cut_ms: float
    back_ms: float


class CutRunner:
    """A pair of nodes, and the link between them that is cut."""

    def __init__(
        self, link: EmulatedLink, sensing: Node, display: Node, felt: FeltForce, rng: random.Random
    ) -> None:
        self.sensing, self.display = sensing, display
        self._link, self._felt, self._rng = link, felt, rng

    def run(self, cut: Cut) -> Recovery:
        """Make one cut and wait for the pulse to be felt again."""
        rng = self._rng
        time.sleep(rng.uniform(*BETWEEN_S))
        began_ns = time.perf_counter_ns()
        for filters, lengths_s in cut.phases:
            self._link.drop(*filters)
            time.sleep(rng.uniform(*rng.choice(lengths_s)))
        self._link.drop()
        ended_ns = time.perf_counter_ns()
        felt_ns = self._felt.steady_from_ns(ended_ns, BACK_WITHIN_S)
        back_ms = BACK_WITHIN_S * 1e3 if felt_ns is None else (felt_ns - ended_ns) * 1e-6
        return Recovery((ended_ns - began_ns) * 1e-6, back_ms)


@contextmanager
def cut_runner(folder: Path, seed: int, whole: LinkScene = WHOLE) -> Iterator[CutRunner]:
    """Provide a pair of nodes on a link that can be cut."""
    scene = folder / "scene.toml"
    text = find_scene("radial").read_text(encoding="utf-8")
    scene.write_text(text.replace('late_target = "1 %"', LATE_TARGET), encoding="utf-8")
    with emulate(whole, seed=seed) as link, node_rig(folder, link) as rig:
        rig.scene = scene
        sensing, display, felt = rig.play()
        yield CutRunner(link, sensing, display, felt, random.Random(seed))


def opened_meanwhile(folder: Path, link_text: str, stop: bool, watched_s: float) -> tuple[int, int]:
    """Count the second connections that were opened and kept in `watched_s` on a link.

    stop: the sensing node is stopped all the time.
    """
    whole = parse_link(f"{WHOLE.text()},{link_text}")
    with emulate(whole) as link, node_rig(folder, link) as rig:
        sensing, _, felt = rig.play()
        if stop:
            sensing.pause()
        time.sleep(watched_s)
        assert felt.status is not None
        counts = felt.status.summary["reconnections"]
        sensing.resume()
    return counts["opened"], counts["kept"]


def where_nothing_is_cut(benchmark: Benchmark) -> None:
    """Print how often a display opened second connections."""
    rows = []
    watched_s = 3.0 if benchmark.quick else WATCHED_S
    for name, text, stop in (
        *((f"a link of {WHOLE_TEXT} that loses {one[5:]}", one, False) for one in LOSSY),
        ("a sensing node that is stopped", LOSSY[0], True),
    ):
        with TemporaryDirectory(prefix="telepulse-") as folder:
            opened, kept = opened_meanwhile(Path(folder), text, stop, watched_s)
        rows.append((name, str(opened), str(kept)))
    title = f"Second connections in {watched_s:g} s (budget: 10, and 1 every 2 s)"
    benchmark.table(title, ("where", "opened", "kept"), rows)


def each_kind(benchmark: Benchmark) -> None:
    """Make each kind of cut many times."""
    rows, all_back_ms, times = [], list[float](), 1 if benchmark.quick else TIMES
    for name, cut in KINDS.items():
        with (
            TemporaryDirectory(prefix="telepulse-") as folder,
            cut_runner(Path(folder), SEED, WHOLE) as runner,
        ):
            found = [runner.run(cut) for _ in range(times)]
            runner.sensing.end()
            summary = runner.display.summary()
        rows.append(_row(name, found))
        all_back_ms += [one.back_ms for one in found]
        if summary.faults or summary.rejected:
            print(name, summary.rejected, summary.faults)
    benchmark.table(
        f"Felt again after the end of a cut, ms ({times} times each)",
        ("cut", "median", "p90", "most", "above 1 s"),
        rows,
    )
    benchmark.judge("time until the pulse is felt again after a cut", 1e-3 * max(all_back_ms))


def _row(name: str, found: Sequence[Recovery]) -> tuple[str, ...]:
    back_ms = sorted(one.back_ms for one in found)
    above = sum(one > BAR_MS for one in back_ms)
    p90_ms = back_ms[round(0.9 * (len(back_ms) - 1))]
    return (
        name,
        f"{statistics.median(back_ms):.0f}",
        f"{p90_ms:.0f}",
        f"{back_ms[-1]:.0f}",
        f"{above} of {len(back_ms)}",
    )
