"""A scene's force loop behind its safety, in virtual time: forces that jump, hosts that stall."""

import math
import random
from collections.abc import Callable, Iterable, Iterator
from itertools import product

import numpy as np
from numpy.typing import NDArray

from display_node.control.force_bounds import ForceBounds
from display_node.control.link_loss import Fade
from display_node.plant.scene import StepperScene
from display_node.scene import DisplayScene

REQUESTED_N = (0.0, 1e30, -1e30, 1.0, 0.3)
FOR_S = (0.005, 0.02, 0.05, 0.1, 0.3, 1.0)
# A half sine, far steeper than a wrist's pulse.
PEAK_N, BEAT_S, EVERY_S = 0.53, 0.12, 0.5
# Number of ticks that a host misses before a tick at a time in s.
Host = Callable[[random.Random, float], int]


def felt_under(
    scene: DisplayScene, requested_n: Iterable[float], actual: StepperScene | None = None
) -> NDArray[np.float64]:
    """Return the felt force in N after each tick, for a requested force in N at each tick.

    actual: the simulated stepper, if it differs from the scene's.
    """
    loop = scene.force_loop(actual)
    fade, bounds = Fade(scene.safety, scene.tick_ns), ForceBounds(scene.safety, scene.tick_ns)
    felt_n = []
    for force_n in requested_n:
        target_n = bounds.bound([force_n] * (loop.horizon + 1), fade.advance(alive=True))
        loop.tick(target_n, loop.read_film())
        felt_n.append(loop.felt_n)
    return np.array(felt_n)


def jumping_n(jumps: int, tick_s: float) -> Iterator[float]:
    """Yield a force in N for each tick, which jumps at random."""
    rng = random.Random(3)
    for _ in range(jumps):
        requested_n, for_s = rng.choice(REQUESTED_N), rng.choice(FOR_S)
        yield from [requested_n] * round(for_s / tick_s)


def swinging_n(period_ticks: int, ticks: int) -> Iterator[float]:
    """Yield a force in N for each tick: jumps up and down beyond all limits, periodically."""
    for tick in range(ticks):
        yield 1e30 if tick % period_ticks < period_ticks // 2 else -1e30


def other_rotors(actuator: StepperScene) -> Iterator[StepperScene]:
    """Yield steppers whose rotor differs by ±20 % in resonance and in damping."""
    for resonance, damping in product((0.8, 1.2), (0.8, 1.0, 1.2)):
        changes = {
            "rotor_resonance_hz": resonance * (actuator.rotor_resonance_hz or math.nan),
            "rotor_damping": damping * actuator.rotor_damping,
        }
        yield actuator.model_copy(update=changes)


def slews_n_per_s(felt_n: NDArray[np.float64], tick_s: float) -> tuple[float, float]:
    """Return the greatest slews of a felt force, up and down."""
    change = np.diff(felt_n) / tick_s
    return float(change.max()), float(-change.min())


def stalls_always(longest: int) -> Host:
    """Return a host that misses 1 to `longest` ticks before every tick, or none."""
    return lambda rng, _: rng.randint(1, longest) if longest else 0


def stalls_at_times(longest: int) -> Host:
    """Return a host that misses 1 to `longest` ticks before every tick for 3 s of every 10."""
    return lambda rng, at_s: rng.randint(1, longest) if at_s % 10 < 3 else 0


def press(scene: DisplayScene, host: Host, seconds: float) -> tuple[float, float]:
    """Play beats on a host that stalls.

    Returns the greatest force, and the RMS difference of felt and wanted force, in N.
    """
    tick_s = scene.tick_ns * 1e-9
    loop = scene.force_loop()
    fade, bounds = Fade(scene.safety, scene.tick_ns), ForceBounds(scene.safety, scene.tick_ns)
    rng = random.Random(7)
    now_s, most_n, squares, ticks = 0.0, 0.0, 0.0, 0
    while now_s < seconds:
        missed = host(rng, now_s)
        loop.coast(missed)
        now_s += missed * tick_s
        begin_s = now_s + loop.actuation_delay_ns * 1e-9
        wanted_n = [beat_n(begin_s + ahead * tick_s) for ahead in range(loop.horizon + 1)]
        most_n = max(most_n, loop.felt_n)
        if fade.gain == 1.0:
            squares, ticks = squares + (loop.felt_n - beat_n(now_s)) ** 2, ticks + 1
        reading_n = loop.read_film()
        bounded_n = bounds.bound(wanted_n, fade.advance(alive=True))
        loop.tick(bounded_n, reading_n)
        most_n = max(most_n, loop.felt_n)
        now_s += tick_s
    return most_n, math.sqrt(squares / ticks)


def beat_n(time_s: float) -> float:
    """Return the wanted force: a half sine, twice a second."""
    into_s = time_s % EVERY_S
    return PEAK_N * math.sin(math.pi * into_s / BEAT_S) if into_s < BEAT_S else 0.0
