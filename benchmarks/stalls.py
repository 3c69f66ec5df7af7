"""Peak force at the finger when the host stalls, in virtual time.

The pulse is a half sine of 0.53 N, far steeper than a wrist's. Between any two ticks the host
misses a number of them, drawn evenly from 1 to the longest, or none for most of the time.
"""

import math
import random
from collections.abc import Callable
from unittest.mock import patch

from benchmarks.measure import show
from display_node.control.controller import StallGuard
from display_node.control.safety import Safety
from display_node.scene import DisplayScene
from protocol.config.scene_file import find_scene
from telepulse.scene import load_scene

PEAK_N = 0.53
BEAT_S, EVERY_S = 0.12, 0.5
SECONDS = 30.0
SCENES = ("radial", "real_bench", "tmcl_bench")
# How many ticks a host misses before one; `at_s` is the time of it.
Host = Callable[[random.Random, float], int]


def between_all(longest: int) -> Host:
    """A host that stalls before every tick."""
    return lambda chance, _: chance.randint(1, longest) if longest else 0


def for_a_while(longest: int) -> Host:
    """Return a host that stalls before every tick for 3 s of every 10."""
    return lambda chance, at_s: chance.randint(1, longest) if at_s % 10 < 3 else 0


HOSTS: dict[str, Host] = {
    "none": between_all(0),
    "1 to 4, 5 % of ticks": lambda chance, _: chance.randint(1, 4) if chance.random() < 0.05 else 0,
    "1 to 6, always": between_all(6),
    "1 to 20, always": between_all(20),
    "1 to 45, always": between_all(45),
    "1 to 45, 3 s in 10": for_a_while(45),
    "30, once in 5 s": lambda chance, _: 30 if chance.random() < 2e-4 else 0,
}


def main() -> None:
    """Print the table; the force limit is 2.5 N."""
    rows = []
    for name in SCENES:
        scene = load_scene(find_scene(name)).display
        for stalls, host in HOSTS.items():
            guarded = pressed(scene, host)
            with patch.object(StallGuard, "tick", lambda *_: None):
                unguarded = pressed(scene, host)
            rows.append(
                (
                    name,
                    stalls,
                    f"{guarded[0]:.2f}",
                    f"{unguarded[0]:.2f}",
                    f"{guarded[1] * 1e3:.2f}",
                    f"{unguarded[1] * 1e3:.2f}",
                )
            )
    show(
        f"Stalls of a host, {SECONDS:g} s each: a beat of {PEAK_N} N is wanted",
        ("scene", "ticks missed", "most N", "unguarded", "RMSE mN", "unguarded"),
        rows,
    )


def pressed(scene: DisplayScene, host: Host, seconds: float = SECONDS) -> tuple[float, float]:
    """The highest force felt, and the RMS of what is felt less what is wanted, both in N."""
    tick_s = scene.tick_ns * 1e-9
    loop = scene.force_loop()
    safety = Safety(scene.safety, scene.tick_ns)
    chance = random.Random(7)
    now_s, most_n, squares, ticks = 0.0, 0.0, 0.0, 0
    while now_s < seconds:
        missed = host(chance, now_s)
        loop.coast(missed)
        now_s += missed * tick_s
        wanted_n = [beat_n(now_s + ahead * tick_s) for ahead in range(loop.horizon + 1)]
        most_n = max(most_n, loop.felt_n)
        if safety.gain == 1.0:
            squares, ticks = squares + (loop.felt_n - wanted_n[0]) ** 2, ticks + 1
        reading_n = loop.read_film()
        most_n = max(most_n, loop.tick(safety.bound(wanted_n, alive=True), reading_n))
        now_s += tick_s
    return most_n, math.sqrt(squares / ticks)


def beat_n(time_s: float) -> float:
    """Return the wanted force: a half sine, twice a second."""
    into_s = time_s % EVERY_S
    return PEAK_N * math.sin(math.pi * into_s / BEAT_S) if into_s < BEAT_S else 0.0
