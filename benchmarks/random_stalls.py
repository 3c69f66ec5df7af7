"""Random stalls of the display's process, in virtual time: is the tip ever left pressed?

The product's own threads are stopped between any two looks at the clock: all of them, the loop
alone, the drive's thread alone; film and stream break off as well. Some time after the last of an
episode's troubles the tip is withdrawn, or the pulse is played. `python -m benchmarks.random_stalls
HOURS` takes another time than three hours.
"""

import math
import os
import random
import sys
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

from benchmarks.lies import KINDS, TOUCH_N, bench_scene, paper_pulse
from benchmarks.measure import show
from benchmarks.virtual_bench import MS, VirtualBench
from benchmarks.virtual_time import VirtualThread
from telepulse.emulators.motor import MotorState

HOURS = 3.0
# Of virtual time, by one seed.
CHUNK_S = 300.0
SHORTEST_S, LONGEST_S = 0.02, 10.0
# From the end of an episode's troubles until it is judged, by the last part of that.
SETTLE_MS, JUDGED_MS = 2_000, 100
# Looks at the clock after which a stall begins: somewhere within what a tick does.
MOST_LOOKS = 12
STATES_PLAYED = ("playing", "starting", "stale")


@dataclass
class Tally:
    """Counts of episodes by name and end, and descriptions of those that left the tip pressed."""

    episodes: Counter[str] = field(default_factory=Counter)
    withdrawn: Counter[str] = field(default_factory=Counter)
    played: Counter[str] = field(default_factory=Counter)
    pressed: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)
    most_n: float = 0.0
    virtual_s: float = 0.0

    def add(self, other: "Tally") -> None:
        """Take over what another counted."""
        for name in ("episodes", "withdrawn", "played", "pressed"):
            getattr(self, name).update(getattr(other, name))
        self.examples += other.examples
        self.most_n = max(self.most_n, other.most_n)
        self.virtual_s += other.virtual_s


class Ordeal:
    """One bench that is stalled again and again; the same seed gives the same ordeal."""

    def __init__(self, kind: str, with_film: bool, seed: int) -> None:
        self._chance = random.Random(seed)
        self._name = f"{kind}, {'film' if with_film else 'no film'}, seed {seed}"
        self._last_pressed_ns = 0
        self.tally = Tally()
        self.bench = VirtualBench(bench_scene(kind), paper_pulse(), with_film, self._watch)

    def run(self, seconds: float) -> Tally:
        """Stall it for so long."""
        with self.bench as bench:
            bench.start()
            began_ns = bench.world.now_ns
            until_ns = began_ns + round(seconds * 1e9)
            while bench.world.now_ns < until_ns:
                bench.run(self._chance.uniform(700, 1_500))
                self._episode()
                if bench.faults:
                    bench.stop()
                    bench.start()
            self.tally.virtual_s = (bench.world.now_ns - began_ns) * 1e-9
        return self.tally

    def _off(self) -> bool:
        """Return whether nothing pressed in the judged last part of the episode."""
        return self.bench.world.now_ns - self._last_pressed_ns > JUDGED_MS * MS

    def _watch(self, moment: MotorState) -> None:
        if moment.force_n > TOUCH_N:
            self._last_pressed_ns = moment.time_ns
            self.tally.most_n = max(self.tally.most_n, moment.force_n)

    def _episode(self) -> None:
        """Make one trouble, or two that overlap, and record what came of it."""
        bench, chance, tally = self.bench, self._chance, self.tally
        names, begin_ns = list[str](), bench.world.now_ns
        end_ns = begin_ns
        for _ in range(1 if chance.random() < 0.7 else 2):
            name, ends_ns = self._trouble()
            names.append(name)
            end_ns = max(end_ns, ends_ns)
            bench.run(chance.uniform(0, 100))
        bench.world.run(max(end_ns, bench.world.now_ns))
        # While the loop alone stands, the drive's own thread withdraws.
        alone = names == ["loop"] and end_ns - begin_ns > SETTLE_MS * MS
        withdrawn_in_time = self._off() or not alone
        bench.film.silent, bench.sending = False, True
        bench.run(SETTLE_MS)
        name = " + ".join(sorted(names))
        tally.episodes[name] += 1
        if self._off() and withdrawn_in_time:
            tally.withdrawn[name] += 1
        elif withdrawn_in_time and not bench.faults and bench.display.state in STATES_PLAYED:
            tally.played[name] += 1
        else:
            tally.pressed[name] += 1
            tally.examples.append(
                f"{self._name}: {name}: {bench.motor.force_n * 1e3:.0f} mN, {bench.faults}"
            )

    def _trouble(self) -> tuple[str, int]:
        """Begin a trouble; its name, and when it ends."""
        bench, chance = self.bench, self._chance
        low, high = math.log(SHORTEST_S), math.log(LONGEST_S)
        lasts_ns = round(math.exp(chance.uniform(low, high)) * 1e9)
        name = chance.choice(("process", "process", "loop", "drive thread", "film", "stream"))
        end_ns = bench.world.now_ns + lasts_ns
        if name in ("film", "stream"):
            if name == "film":
                bench.film.silent = True
                bench.world.at(end_ns, lambda: setattr(bench.film, "silent", False))
            else:
                bench.sending = False
                bench.world.at(end_ns, lambda: setattr(bench, "sending", True))
            return name, end_ns
        # A stall begins within what a tick does, by when some ms have passed.
        end_ns += 20 * MS
        bench.world.interrupt(chance.randint(1, MOST_LOOKS), self._stall(name, end_ns))
        return name, end_ns

    def _stall(self, name: str, end_ns: int) -> Callable[[], None]:
        def begin() -> None:
            threads = [thread for thread in self.bench.threads if _is_of(thread, name)]
            self._chance.shuffle(threads)
            self.bench.world.stall(threads, end_ns)

        return begin


def _is_of(thread: VirtualThread, name: str) -> bool:
    """Return whether a stall of that name stops a thread."""
    if name == "process":
        return True
    return (thread.name == "loop") == (name == "loop") and thread.name not in ("film", "notifier")


def chunk(kind: str, with_film: bool, seed: int, seconds: float = CHUNK_S) -> Tally:
    """Run one ordeal."""
    return Ordeal(kind, with_film, seed).run(seconds)


def main(hours: float = HOURS) -> None:
    """Print the table."""
    began_s, count = time.perf_counter(), math.ceil(hours * 3600 / CHUNK_S)
    # A bench with a film is the usual one.
    jobs = [(KINDS[seed % 2], seed // 2 % 4 != 3, seed) for seed in range(count)]
    total = Tally()
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        for tally in pool.map(chunk, *zip(*jobs, strict=True)):
            total.add(tally)
            done = f"{total.virtual_s / 3600:.2f} h: {total.episodes.total()} episodes"
            print(f"{done}, {total.pressed.total()} left pressed", file=sys.stderr)
    took_s = time.perf_counter() - began_s
    names = sorted(total.episodes)
    columns = (total.episodes, total.withdrawn, total.played, total.pressed)
    rows = [(name, *(str(column[name]) for column in columns)) for name in names]
    rows.append(("all", *(str(column.total()) for column in columns)))
    show(
        f"Random stalls of {SHORTEST_S:g} to {LONGEST_S:g} s in {total.virtual_s / 3600:.1f} h of"
        f" virtual time ({took_s / 60:.0f} min); most felt {total.most_n:.2f} N",
        ("stalled", "episodes", "withdrawn", "played", "left pressed"),
        rows,
    )
    for example in total.examples[:10]:
        print(example)


if __name__ == "__main__":
    main(*map(float, sys.argv[1:2]))
