"""Kinds of cuts, many times each, and how often a display reconnects where nothing is cut.

One pair of nodes serves all cuts of a kind: fifty take some three minutes. Each cut begins at a
random instant. The time counts from its end until the pulse is felt again at full strength for at
least 0.3 s. Needs root, for the link emulator.
"""

import random
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.benchmark import Benchmark
from benchmarks.faults.cases import WHOLE, repeat
from protocol.config.scene_file import find_scene
from protocol.summary.fields import Summary
from telepulse.simulation.link_scene import parse_link
from tests.support.netem import PacketFilter, emulate
from tests.support.node_rig import PORT, node_rig

WHOLE_TEXT = "20±3 ms"
TIMES = 50
SEED = 1
BAR_MS = 1e3
# A lossy link or a stopped node must not make a display reconnect again and again.
WATCHED_S = 30.0
LOSSY = ("loss=0%", "loss=5%", "loss=20%")
# Between two cuts TCP and the delay estimate settle, and the phase becomes random.
BETWEEN_S = (0.7, 1.5)
SHORT_S, LONG_S = (0.1, 0.6), (0.6, 3.0)

# Cuts in quick succession are jitter to a display: after a few, a longer playout delay would cover
# them. This scene's covers only the shorter half of all delays.
LATE_TARGET = 'late_target = "50 %"'

DATA, CONTROL = PacketFilter(port=PORT), PacketFilter(port=PORT + 1)
ALL = PacketFilter()
TO_DISPLAY, TO_SENSING = PacketFilter(towards="display"), PacketFilter(towards="sensing")
SYN = PacketFilter(syn_only=True)


# Two of three cuts are short.
MIXED = (SHORT_S, SHORT_S, LONG_S)
# By kind of cut, for each of its phases: what is dropped, and the ranges of its length in s.
KINDS: dict[str, Sequence[tuple[PacketFilter, Sequence[tuple[float, float]]]]] = {
    "both ports, 0.1 to 0.6 s": [(ALL, (SHORT_S,))],
    "both ports, 0.6 to 3 s": [(ALL, (LONG_S,))],
    "data port alone": [(DATA, MIXED)],
    "control port alone": [(CONTROL, MIXED)],
    "towards the display alone": [(TO_DISPLAY, MIXED)],
    "towards the sensing node alone": [(TO_SENSING, MIXED)],
    "both ports, then requests to connect": [(ALL, MIXED), (SYN, MIXED)],
}


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
    for name in KINDS:
        back_ms, summary = recoveries(name, times)
        rows.append(_row(name, back_ms))
        all_back_ms += back_ms
        if summary.faults or summary.rejected:
            print(name, summary.rejected, *map(str, summary.faults))
    benchmark.table(
        f"Felt again after the end of a cut, ms ({times} times each)",
        ("cut", "median", "p90", "most", "above 1 s"),
        rows,
    )
    benchmark.judge("time until the pulse is felt again after a cut", 1e-3 * max(all_back_ms))


def recoveries(name: str, times: int) -> tuple[list[float], Summary]:
    """Make one kind of cut many times; return the times in ms until the pulse was felt again."""
    rng, text = random.Random(SEED), find_scene("radial").read_text(encoding="utf-8")
    with (
        TemporaryDirectory(prefix="telepulse-") as folder,
        emulate(WHOLE, seed=SEED) as link,
        node_rig(Path(folder), link) as rig,
    ):
        rig.scene = Path(folder, "scene.toml")
        rig.scene.write_text(text.replace('late_target = "1 %"', LATE_TARGET), encoding="utf-8")
        sensing, display, felt = rig.play()

        def cut() -> int:
            for dropped, lengths_s in KINDS[name]:
                link.drop(dropped)
                time.sleep(rng.uniform(*rng.choice(lengths_s)))
            link.drop()
            return time.perf_counter_ns()

        back_ms = repeat(felt, times, rng, cut, BETWEEN_S)
        sensing.end()
        return sorted(back_ms), display.summary()


def _row(name: str, back_ms: Sequence[float]) -> tuple[str, ...]:
    above = sum(one > BAR_MS for one in back_ms)
    p90_ms = back_ms[round(0.9 * (len(back_ms) - 1))]
    return (
        name,
        f"{statistics.median(back_ms):.0f}",
        f"{p90_ms:.0f}",
        f"{back_ms[-1]:.0f}",
        f"{above} of {len(back_ms)}",
    )
