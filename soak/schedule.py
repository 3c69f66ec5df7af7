"""Schedule of a soak's faults, from a seed.

Kinds are drawn from a shuffled deck, which is refilled when it is empty. So each kind is made
equally often. The faults of the bench are drawn in the same way. From the fourth deck on, the
sensing node is no longer ended: a process that runs for seconds shows no trend in its resources.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from random import Random

CONTINUOUS, RESTARTED, TEMPORARY = "continuous", "restarted", "temporary"
"""The displays: never killed, over two paths; killed at times, over one; joins and leaves."""

SENSING, PORTS = "sensing", "ports"
FLOODS = ("bytes", "messages", "connections", "telemetry")
# Share of episodes with two faults.
PAIRED_SHARE = 0.25
# Rest between faults, in which the pulse is felt again at every display, and reported.
REST_S = (3.0, 4.5)
SENSING_ENDS = ("kill sensing", "restart sensing", "impostor")
DISPLAY_ENDS = ("kill display", "restart display")
RESTARTS = ("restart sensing", "restart display")
FREEZES = ("freeze sensing", "freeze display")
# On the link of a display.
LINK_KINDS = ("cut", "cut of one path", "loss", "delay")
# Kind of a fault → what floods the ports.
FLOOD_KINDS = {f"flood of {name}": name for name in FLOODS}
_LENGTHS_S = {
    "kill sensing": (0.2, 3.0),
    "restart sensing": (0.2, 2.0),
    "impostor": (1.0, 4.0),
    "kill display": (0.2, 3.0),
    "restart display": (0.2, 2.0),
    "freeze sensing": (0.1, 2.0),
    "freeze display": (0.3, 6.0),
    "cut": (0.3, 5.0),
    "cut of one path": (0.5, 5.0),
    "loss": (2.0, 5.0),
    "delay": (2.0, 5.0),
    "temporary display": (5.0, 8.0),
    **dict.fromkeys(FLOOD_KINDS, (2.0, 4.0)),
}
KINDS = tuple(_LENGTHS_S)
ENDING_DECKS = 3
# The watchdog of the bench's drive in s. A shorter stall is tolerated, a longer one is a fault.
BENCH_WATCHDOG_S = 0.2
# Uniform in the logarithm: around the watchdog's time, and far beyond it.
_BENCH_LENGTHS_S = {
    "cut": (0.0, 0.0),
    "short stall": (0.05, 0.75 * BENCH_WATCHDOG_S),
    "long stall": (1.5 * BENCH_WATCHDOG_S, 5.0),
}
BENCH_KINDS = tuple(_BENCH_LENGTHS_S)


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault that begins `after_s` after the start of its episode and lasts for `for_s`.

    target: a node by its role, or the "ports". detail: the changes of a display's link, or the way
    in which a temporary display leaves.
    """

    kind: str
    target: str
    after_s: float
    for_s: float
    detail: str = ""

    @property
    def part(self) -> tuple[str, bool]:
        """The part that it is made on: the target, or its link."""
        return self.target, self.kind in LINK_KINDS


@dataclass(frozen=True, slots=True)
class Trouble:
    """A fault on the bench.

    kind: "cut" (the sensing node is killed), "short stall" or "long stall" (the display is stopped
    for `for_s`). after_s: time from when the pulse is felt until the fault.
    """

    kind: str
    after_s: float
    for_s: float

    def __str__(self) -> str:
        return f"{self.kind} {self.for_s:.2f} s" if self.for_s else self.kind


@dataclass(frozen=True, slots=True)
class Episode:
    """One fault, or two that overlap, and the rest after them."""

    faults: tuple[Fault, ...]
    rest_s: float

    @property
    def kind(self) -> str:
        """Return the kinds of its faults as one label."""
        return " + ".join(sorted(fault.kind for fault in self.faults))


def episodes(seed: int) -> Iterator[Episode]:
    """Yield the episodes of a soak, endlessly; the same seed gives the same ones."""
    random = Random(seed)
    faults = _faults(random)
    held: Fault | None = None
    while True:
        first, held = held or next(faults), None
        chosen = [first]
        if random.random() < PAIRED_SHARE:
            second = next(faults)
            # Two faults of one part are made one after the other.
            if second.part == first.part:
                held = second
            else:
                after_s = round(random.uniform(0.0, first.for_s), 2)
                chosen.append(
                    Fault(second.kind, second.target, after_s, second.for_s, second.detail)
                )
        yield Episode(tuple(chosen), round(random.uniform(*REST_S), 2))


def troubles(seed: int) -> Iterator[Trouble]:
    """Yield the faults of the bench, endlessly; the same seed gives the same ones.

    The first is a long stall, so that a single round includes a fault.
    """
    random = Random(seed)
    for number in itertools.count():
        deck = random.sample(BENCH_KINDS, len(BENCH_KINDS))
        if number == 0:
            deck.sort(key=lambda kind: kind != "long stall")
        for kind in deck:
            low_s, high_s = _BENCH_LENGTHS_S[kind]
            for_s = low_s and low_s * (high_s / low_s) ** random.random()
            yield Trouble(kind, round(random.uniform(0.5, 2.0), 2), round(for_s, 3))


def _faults(random: Random) -> Iterator[Fault]:
    for number in itertools.count():
        deck = [kind for kind in KINDS if number < ENDING_DECKS or kind not in SENSING_ENDS]
        for kind in random.sample(deck, len(deck)):
            for_s = round(random.uniform(*_LENGTHS_S[kind]), 2)
            target, detail = _target(kind, random)
            yield Fault(kind, target, 0.0, for_s, detail)


def _target(kind: str, random: Random) -> tuple[str, str]:
    display = random.choice((CONTINUOUS, RESTARTED))
    match kind:
        case _ if kind in (*SENSING_ENDS, "freeze sensing"):
            return SENSING, ""
        case _ if kind in DISPLAY_ENDS:
            return RESTARTED, ""
        case "freeze display":
            return display, ""
        case "cut":
            return display, "loss=100%"
        case "cut of one path":
            return CONTINUOUS, "loss=100%"
        case "loss":
            return display, f"loss={random.uniform(1, 10):.1f}%"
        case "delay":
            delay_ms, jitter_ms = random.uniform(20, 100), random.uniform(0, 10)
            return display, f"delay={delay_ms:.0f}ms,jitter={jitter_ms:.1f}ms"
        case "temporary display":
            return TEMPORARY, random.choice(("killed", "stopped"))
    return PORTS, ""
