"""Random stalls of the display's process, on a bench in virtual time.

The product's own threads are stopped between any two readings of the clock: all of them, the loop
alone, or the drive's thread alone. Film and stream are interrupted as well. After each episode the
tip must be withdrawn or the pulse played.
"""

import math
import random
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from telepulse.emulators.motor import MotorState
from tests.support.fault_runs import TOUCH_N, bench_scene, paper_pulse
from tests.support.sender import MS
from tests.support.threaded_bench import ThreadedBench
from tests.support.virtual_time import VirtualThread

SHORTEST_S, LONGEST_S = 0.02, 10.0
# From the end of an episode until it is judged, by the last part of that time.
SETTLE_MS, JUDGED_MS = 2_000, 100
# Readings of the clock after which a stall begins: somewhere within the work of a tick.
MOST_READINGS = 12
STATES_PLAYED = ("playing", "starting", "stale")


@dataclass
class StallCounts:
    """Counts of episodes by kind and result, with descriptions of those that ended pressed."""

    episodes: Counter[str] = field(default_factory=Counter)
    withdrawn: Counter[str] = field(default_factory=Counter)
    played: Counter[str] = field(default_factory=Counter)
    pressed: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)
    most_n: float = 0.0
    virtual_s: float = 0.0

    def add(self, other: "StallCounts") -> None:
        """Add the counts of another run."""
        for name in ("episodes", "withdrawn", "played", "pressed"):
            getattr(self, name).update(getattr(other, name))
        self.examples += other.examples
        self.most_n = max(self.most_n, other.most_n)
        self.virtual_s += other.virtual_s


class StallRun:
    """A bench that is stalled repeatedly; runs of the same seed are identical."""

    def __init__(self, kind: str, with_film: bool, seed: int) -> None:
        self._random = random.Random(seed)
        self._name = f"{kind}, {'film' if with_film else 'no film'}, seed {seed}"
        self._last_pressed_ns = 0
        self.counts = StallCounts()
        self.bench = ThreadedBench(bench_scene(kind), paper_pulse(), with_film, self._watch)

    def run(self, seconds: float) -> StallCounts:
        """Make episodes for so long."""
        with self.bench as bench:
            bench.start()
            began_ns = bench.world.now_ns
            until_ns = began_ns + round(seconds * 1e9)
            while bench.world.now_ns < until_ns:
                bench.run(self._random.uniform(700, 1_500))
                self._episode()
                if bench.faults:
                    bench.stop()
                    bench.start()
            self.counts.virtual_s = (bench.world.now_ns - began_ns) * 1e-9
        return self.counts

    def _off(self) -> bool:
        """Return whether the tip was off the finger in the judged time."""
        return self.bench.world.now_ns - self._last_pressed_ns > JUDGED_MS * MS

    def _watch(self, moment: MotorState) -> None:
        if moment.force_n > TOUCH_N:
            self._last_pressed_ns = moment.time_ns
            self.counts.most_n = max(self.counts.most_n, moment.force_n)

    def _episode(self) -> None:
        """Make one disturbance, or two that overlap, and count the result."""
        bench, rng, counts = self.bench, self._random, self.counts
        names, begin_ns = list[str](), bench.world.now_ns
        end_ns = begin_ns
        for _ in range(1 if rng.random() < 0.7 else 2):
            name, ends_ns = self._disturb()
            names.append(name)
            end_ns = max(end_ns, ends_ns)
            bench.run(rng.uniform(0, 100))
        bench.world.run(max(end_ns, bench.world.now_ns))
        # While the loop alone is stalled, the drive's own thread withdraws.
        alone = names == ["loop"] and end_ns - begin_ns > SETTLE_MS * MS
        withdrawn_in_time = self._off() or not alone
        bench.film.silent, bench.sending = False, True
        bench.run(SETTLE_MS)
        name = " + ".join(sorted(names))
        counts.episodes[name] += 1
        if self._off() and withdrawn_in_time:
            counts.withdrawn[name] += 1
        elif withdrawn_in_time and not bench.faults and bench.display.state in STATES_PLAYED:
            counts.played[name] += 1
        else:
            counts.pressed[name] += 1
            counts.examples.append(
                f"{self._name}: {name}: {bench.motor.force_n * 1e3:.0f} mN, {bench.faults}"
            )

    def _disturb(self) -> tuple[str, int]:
        """Begin a disturbance; return its name and its end."""
        bench, rng = self.bench, self._random
        low, high = math.log(SHORTEST_S), math.log(LONGEST_S)
        lasts_ns = round(math.exp(rng.uniform(low, high)) * 1e9)
        name = rng.choice(("process", "process", "loop", "drive thread", "film", "stream"))
        end_ns = bench.world.now_ns + lasts_ns
        if name == "film":
            bench.film.silent = True
            bench.world.at(end_ns, lambda: setattr(bench.film, "silent", False))
        elif name == "stream":
            bench.sending = False
            bench.world.at(end_ns, lambda: setattr(bench, "sending", True))
        else:
            # A stall begins within the work of a tick, after some ms.
            end_ns += 20 * MS
            bench.world.interrupt(rng.randint(1, MOST_READINGS), self._stall(name, end_ns))
        return name, end_ns

    def _stall(self, name: str, end_ns: int) -> Callable[[], None]:
        def begin() -> None:
            threads = [thread for thread in self.bench.threads if _stops(name, thread)]
            self._random.shuffle(threads)
            self.bench.world.stall(threads, end_ns)

        return begin


def _stops(name: str, thread: VirtualThread) -> bool:
    if name == "process":
        return True
    return (thread.name == "loop") == (name == "loop") and thread.name not in ("film", "notifier")
