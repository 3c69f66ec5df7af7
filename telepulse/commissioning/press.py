"""Pressing gently and by plan: a slow ramp up and down, then a staircase of small steps.

The steps go one way, so that no play is crossed between them, and come at times without a
period, so that they excite all frequencies. The film watches every tick: beyond the guard the
press ends at once.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from display_node.plant.second_order import SecondOrderScene
from display_node.plant.stepper import StepperScene
from protocol.errors import BenchError
from telepulse.commissioning.response import Input
from telepulse.commissioning.rig import Rig

Array = NDArray[np.float64]

STILL_S = 1.0
# How fast the slow ramp presses, by what the scene says of the finger.
RAMP_N_PER_S = 0.2
# The way that is searched for a touch, beyond where the scene has it.
SEARCH_M = 3e-3
# From here on, as a share of the force, the film tells where the tip is.
LOWEST_SHARE = 0.1
STEPS = 12
DWELL_S = (0.08, 0.2)
SEED = 1
# Ticks; a drive obeys each speed a little early or late, and a longer way averages that.
LEAST_RISE = 3
# The same in periods of the second-order model, which is called slower than this at least.
SLOW_DWELL = (0.2, 1.0)
LEAST_K = 1e-3
# The film may say so much more than is pressed on purpose, before the press is given up.
GUARD = 1.5


@dataclass(slots=True)
class PressRecorder:
    """Drives a rig, keeps what was told and said, and stops when the film says too much.

    most_n: the film's reading that ends the press; silent_s: so does a film that says nothing
    for so long. Raises BenchError then; the rig is back where it began by then.
    """

    rig: Rig
    most_n: float
    silent_s: float
    told_s: list[float] = field(default_factory=list)
    output: list[float] = field(default_factory=list)
    film_s: list[float] = field(default_factory=list)
    film_n: list[float] = field(default_factory=list)
    zero_n: float = 0.0

    def run(self, outputs: Iterable[float]) -> None:
        """Tell one output a tick."""
        for output in outputs:
            told_s, samples = self.rig.tick(output)
            self.told_s.append(told_s)
            self.output.append(output)
            for sample in samples:
                self.film_s.append(sample.time_s)
                self.film_n.append(sample.force_n)
                self._guard(sample.force_n)
            if told_s - (self.film_s[-1] if self.film_s else self.told_s[0]) > self.silent_s:
                self._end(f"the film said nothing for {self.silent_s * 1e3:.0f} ms")

    @property
    def force_n(self) -> float:
        """What the film says now, above its zero."""
        return self.film_n[-1] - self.zero_n if self.film_n else 0.0

    @property
    def now_s(self) -> float:
        """When the last output was told."""
        return self.told_s[-1]

    def _guard(self, force_n: float) -> None:
        if not abs(force_n - self.zero_n) <= self.most_n:
            self._end(f"the film says {force_n - self.zero_n:.3g} N, above {self.most_n:.3g} N")

    def _end(self, why: str) -> None:
        self.rig.retreat()
        raise BenchError(f"stopped pressing and went back: {why}")


@dataclass(frozen=True, slots=True)
class Phase:
    """A part of a press, by its times on the rig's clock."""

    begin_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Pressed:
    """A press: still, slowly up, slowly down, the staircase; told and film as recorded.

    up and down are None for an actuator without a place of its own (a voltage's).
    """

    recorder: PressRecorder
    still: Phase
    up: Phase | None
    down: Phase | None
    stairs: Phase

    def film(self, phase: Phase) -> tuple[Array, Array]:
        """Times from the phase's begin and readings in N, as they were said."""
        time_s, force_n = np.array(self.recorder.film_s), np.array(self.recorder.film_n)
        inside = (time_s >= phase.begin_s) & (time_s <= phase.end_s)
        return time_s[inside] - phase.begin_s, force_n[inside]

    def told(self, phase: Phase, held: bool) -> Input:
        """What was told in a phase, once a tick: the output itself where it is a held voltage,
        else the way of the screw in m, which runs straight under a held speed."""
        told_s, output = np.array(self.recorder.told_s), np.array(self.recorder.output)
        tick_s = self.recorder.rig.tick_s
        grid_s = phase.begin_s + tick_s * np.arange(
            round((phase.end_s - phase.begin_s) / tick_s) + 1
        )
        if held:
            last = np.searchsorted(told_s, grid_s + tick_s / 2) - 1
            return Input(output[np.maximum(last, 0)], tick_s, held=True)
        way_m = np.concatenate([[0.0], np.cumsum(output[:-1] * np.diff(told_s))])
        return Input(np.interp(grid_s, told_s, way_m), tick_s, held=False)


def press_stepper(recorder: PressRecorder, scene: StepperScene, force_n: float) -> Pressed:
    """Press with at most about force_n; ends where it began. Raises BenchError.

    The scene says how fast the drive may be; its finger sets the slow ramp's speed.
    """
    still = _still(recorder)
    slow = RAMP_N_PER_S / scene.fingertip_n_per_m
    low_n = LOWEST_SHARE * force_n
    up = _ramp(recorder, slow, force_n)
    down = _ramp(recorder, -slow, low_n / 2)
    _ramp(recorder, slow, low_n)
    step_m = _way(recorder, up, low_n) / STEPS
    stairs = _stairs(recorder, step_m, scene.max_acceleration_m_per_s2 / 2)
    _home(recorder, slow)
    return Pressed(recorder, still, up, down, stairs)


def press_voltage(recorder: PressRecorder, scene: SecondOrderScene, force_n: float) -> Pressed:
    """As press_stepper, with a staircase of voltages; the scene says how slow it must be."""
    still = _still(recorder)
    begin_s, rng = recorder.now_s, np.random.default_rng(SEED)
    tick_s, stiffness = recorder.rig.tick_s, max(scene.k, LEAST_K)
    period_s = 2 * math.pi * math.sqrt(scene.m / stiffness)
    for step in range(1, STEPS + 1):
        # Half of the force at most: the model may swing to twice of a step.
        volts = stiffness * force_n * step / (2 * STEPS)
        recorder.run([volts] * max(1, round(rng.uniform(*SLOW_DWELL) * period_s / tick_s)))
    stairs = Phase(begin_s, recorder.now_s)
    recorder.run([0.0] * round(period_s / tick_s))
    return Pressed(recorder, still, None, None, stairs)


def profile(way_m: float, acceleration_m_per_s2: float, tick_s: float) -> list[float]:
    """Speeds, one a tick, that make a way from rest to rest: up and down in equal steps."""
    rise = max(LEAST_RISE, math.ceil(math.sqrt(abs(way_m) / acceleration_m_per_s2) / tick_s))
    shape = [*range(1, rise + 1), *range(rise - 1, 0, -1)]
    return [way_m / (sum(shape) * tick_s) * part for part in shape]


def _still(recorder: PressRecorder) -> Phase:
    begin = len(recorder.told_s)
    # Before its zero is known the film may say anything.
    guard, recorder.most_n = recorder.most_n, math.inf
    recorder.run([0.0] * round(STILL_S / recorder.rig.tick_s))
    if not recorder.film_n:
        raise BenchError("the film says nothing")
    recorder.zero_n, recorder.most_n = float(np.mean(recorder.film_n)), guard
    return Phase(recorder.told_s[begin], recorder.now_s)


def _ramp(recorder: PressRecorder, speed_m_per_s: float, until_n: float) -> Phase:
    """Go slowly until the film is past a force."""
    begin_s = recorder.now_s
    for _ in range(round(SEARCH_M / abs(speed_m_per_s) / recorder.rig.tick_s)):
        recorder.run([speed_m_per_s])
        if (recorder.force_n - until_n) * speed_m_per_s >= 0:
            return Phase(begin_s, recorder.now_s)
    recorder.run([0.0])
    recorder.rig.retreat()
    where = "nothing was touched" if speed_m_per_s > 0 else "the film still feels something"
    raise BenchError(
        f"{where} on {SEARCH_M * 1e3:.0f} mm of way: the film reads"
        f" {recorder.force_n * 1e3:.0f} mN; look at film, drive direction and first touch"
    )


def _way(recorder: PressRecorder, up: Phase, from_n: float) -> float:
    """How far the ramp went from a force to its end."""
    pressed = Pressed(recorder, up, up, up, up)
    at_s, force_n = pressed.film(up)
    way = pressed.told(up, held=False)
    below = np.flatnonzero(force_n - recorder.zero_n < from_n)
    from_s = at_s[below[-1]] if len(below) else 0.0
    from_m = np.interp(from_s, way.tick_s * np.arange(len(way.values)), way.values)
    return float(way.values[-1] - from_m)


def _stairs(recorder: PressRecorder, step_m: float, acceleration: float) -> Phase:
    begin_s, rng, tick_s = recorder.now_s, np.random.default_rng(SEED), recorder.rig.tick_s
    for _ in range(STEPS):
        recorder.run([0.0] * round(rng.uniform(*DWELL_S) / tick_s))
        recorder.run(profile(step_m, acceleration, tick_s))
    recorder.run([0.0] * round(DWELL_S[1] / tick_s))
    return Phase(begin_s, recorder.now_s)


def _home(recorder: PressRecorder, slow_m_per_s: float) -> None:
    """Go back to where the press began, ten times as fast as the ramp."""
    told_s, output = np.array(recorder.told_s), np.array(recorder.output)
    way_m = float(np.sum(output[:-1] * np.diff(told_s)))
    fast, tick_s = 10 * slow_m_per_s, recorder.rig.tick_s
    ticks = max(1, math.ceil(abs(way_m) / fast / tick_s))
    recorder.run([-way_m / (ticks * tick_s)] * ticks)
    recorder.run([0.0] * round(STILL_S / 4 / tick_s))
