"""Pressing gently and by plan: a slow ramp up and down, then a staircase of small steps.

The steps go one way, so that no play is crossed between them, and come at times without a
period, so that they excite all frequencies. The film watches every tick: beyond the guard the
press ends at once.

Contact under the actuator, from a slow ramp up and down: stiffness, touch and play.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from display_node.plant.contact import ContactLaw
from display_node.plant.film import FilmTable
from display_node.plant.second_order import SecondOrderScene
from display_node.plant.stepper import StepperScene
from protocol.errors import BenchError
from telepulse.commissioning.identification import ActuatorInput, Array
from telepulse.commissioning.rig import Rig

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
class PressPhase:
    """A part of a press, by its times on the rig's clock."""

    begin_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class PressRecord:
    """A press: still, slowly up, slowly down, the staircase; told and film as recorded.

    up and down are None for an actuator without a place of its own (a voltage's).
    """

    recorder: PressRecorder
    still: PressPhase
    up: PressPhase | None
    down: PressPhase | None
    stairs: PressPhase

    def film(self, phase: PressPhase) -> tuple[Array, Array]:
        """Times from the phase's begin and readings in N, as they were said."""
        time_s, force_n = np.array(self.recorder.film_s), np.array(self.recorder.film_n)
        inside = (time_s >= phase.begin_s) & (time_s <= phase.end_s)
        return time_s[inside] - phase.begin_s, force_n[inside]

    def told(self, phase: PressPhase, held: bool) -> ActuatorInput:
        """What was told in a phase, once a tick: the output itself where it is a held voltage,
        else the way of the screw in m, which runs straight under a held speed."""
        told_s, output = np.array(self.recorder.told_s), np.array(self.recorder.output)
        tick_s = self.recorder.rig.tick_s
        grid_s = phase.begin_s + tick_s * np.arange(
            round((phase.end_s - phase.begin_s) / tick_s) + 1
        )
        if held:
            last = np.searchsorted(told_s, grid_s + tick_s / 2) - 1
            return ActuatorInput(output[np.maximum(last, 0)], tick_s, held=True)
        way_m = np.concatenate([[0.0], np.cumsum(output[:-1] * np.diff(told_s))])
        return ActuatorInput(np.interp(grid_s, told_s, way_m), tick_s, held=False)


def press_stepper(recorder: PressRecorder, scene: StepperScene, force_n: float) -> PressRecord:
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
    return PressRecord(recorder, still, up, down, stairs)


def press_voltage(recorder: PressRecorder, scene: SecondOrderScene, force_n: float) -> PressRecord:
    """As press_stepper, with a staircase of voltages; the scene says how slow it must be."""
    still = _still(recorder)
    begin_s, rng = recorder.now_s, np.random.default_rng(SEED)
    tick_s, stiffness = recorder.rig.tick_s, max(scene.k, LEAST_K)
    period_s = 2 * math.pi * math.sqrt(scene.m / stiffness)
    for step in range(1, STEPS + 1):
        # Half of the force at most: the model may swing to twice of a step.
        volts = stiffness * force_n * step / (2 * STEPS)
        recorder.run([volts] * max(1, round(rng.uniform(*SLOW_DWELL) * period_s / tick_s)))
    stairs = PressPhase(begin_s, recorder.now_s)
    recorder.run([0.0] * round(period_s / tick_s))
    return PressRecord(recorder, still, None, None, stairs)


def profile(way_m: float, acceleration_m_per_s2: float, tick_s: float) -> list[float]:
    """Speeds, one a tick, that make a way from rest to rest: up and down in equal steps."""
    rise = max(LEAST_RISE, math.ceil(math.sqrt(abs(way_m) / acceleration_m_per_s2) / tick_s))
    shape = [*range(1, rise + 1), *range(rise - 1, 0, -1)]
    return [way_m / (sum(shape) * tick_s) * part for part in shape]


def _still(recorder: PressRecorder) -> PressPhase:
    begin = len(recorder.told_s)
    # Before its zero is known the film may say anything.
    guard, recorder.most_n = recorder.most_n, math.inf
    recorder.run([0.0] * round(STILL_S / recorder.rig.tick_s))
    if not recorder.film_n:
        raise BenchError("the film says nothing")
    recorder.zero_n, recorder.most_n = float(np.mean(recorder.film_n)), guard
    return PressPhase(recorder.told_s[begin], recorder.now_s)


def _ramp(recorder: PressRecorder, speed_m_per_s: float, until_n: float) -> PressPhase:
    """Go slowly until the film is past a force."""
    begin_s = recorder.now_s
    for _ in range(round(SEARCH_M / abs(speed_m_per_s) / recorder.rig.tick_s)):
        recorder.run([speed_m_per_s])
        if (recorder.force_n - until_n) * speed_m_per_s >= 0:
            return PressPhase(begin_s, recorder.now_s)
    recorder.run([0.0])
    recorder.rig.retreat()
    where = "nothing was touched" if speed_m_per_s > 0 else "the film still feels something"
    raise BenchError(
        f"{where} on {SEARCH_M * 1e3:.0f} mm of way: the film reads"
        f" {recorder.force_n * 1e3:.0f} mN; look at film, drive direction and first touch"
    )


def _way(recorder: PressRecorder, up: PressPhase, from_n: float) -> float:
    """How far the ramp went from a force to its end."""
    pressed = PressRecord(recorder, up, up, up, up)
    at_s, force_n = pressed.film(up)
    way = pressed.told(up, held=False)
    below = np.flatnonzero(force_n - recorder.zero_n < from_n)
    from_s = at_s[below[-1]] if len(below) else 0.0
    from_m = np.interp(from_s, way.tick_s * np.arange(len(way.values)), way.values)
    return float(way.values[-1] - from_m)


def _stairs(recorder: PressRecorder, step_m: float, acceleration: float) -> PressPhase:
    begin_s, rng, tick_s = recorder.now_s, np.random.default_rng(SEED), recorder.rig.tick_s
    for _ in range(STEPS):
        recorder.run([0.0] * round(rng.uniform(*DWELL_S) / tick_s))
        recorder.run(profile(step_m, acceleration, tick_s))
    recorder.run([0.0] * round(DWELL_S[1] / tick_s))
    return PressPhase(begin_s, recorder.now_s)


def _home(recorder: PressRecorder, slow_m_per_s: float) -> None:
    """Go back to where the press began, ten times as fast as the ramp."""
    told_s, output = np.array(recorder.told_s), np.array(recorder.output)
    way_m = float(np.sum(output[:-1] * np.diff(told_s)))
    fast, tick_s = 10 * slow_m_per_s, recorder.rig.tick_s
    ticks = max(1, math.ceil(abs(way_m) / fast / tick_s))
    recorder.run([-way_m / (ticks * tick_s)] * ticks)
    recorder.run([0.0] * round(STILL_S / 4 / tick_s))


# 95 % of a normal distribution lie within so many standard deviations.
WITHIN = 1.96
# Readings of so much time are taken together: a film's noise is not a place.
TOGETHER_S = 0.01
LEAST_PLACES = 8
# Of the largest force: below, the film does not tell where the tip is.
LOWEST_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class ContactFit:
    """The finger's stiffness in N/m, the place of first touch in m from where the press began,
    and the play in m; each with its 95 % interval to either side.

    play_m below 0: the way back presses more than the way in. unexplained: RMS of the places that
    the fit leaves over, as a share of that of all places.
    """

    finger_n_per_m: float
    finger_within: float
    touch_m: float
    touch_within: float
    play_m: float
    play_within: float
    unexplained: float

    def pressed_n(self, law: ContactLaw, way: ActuatorInput) -> ActuatorInput:
        """The force that each place of the screw presses with, at rest, on its way in."""
        tip_m = way.values - self.touch_m
        force_n = np.array([law.force(x) for x in tip_m.tolist()])
        return ActuatorInput(force_n, way.tick_s, held=False)


def fit_contact(pressed: PressRecord, law: ContactLaw, film: FilmTable, lag_s: float) -> ContactFit:
    """Fit x = touch − play · [going back] + rubber F^(2/3) + F / finger by linear least squares.

    The rubber's part is the law's own. lag_s: from a command to the film's reading, without the
    film's filter, which is made good here. Raises BenchError for a record that does not tell.
    """
    assert pressed.up is not None
    assert pressed.down is not None
    both = PressPhase(pressed.up.begin_s, pressed.down.end_s)
    place_m, force_n, back = [], [], []
    for phase in (pressed.up, pressed.down):
        at_s, read_n = pressed.film(phase)
        seen_m = through_film(pressed.told(both, held=False), film)
        late_s = at_s + phase.begin_s - both.begin_s - lag_s
        x_m = np.interp(late_s, seen_m.tick_s * np.arange(len(seen_m.values)), seen_m.values)
        x_m, read_n = _together(at_s, x_m), _together(at_s, read_n) - pressed.recorder.zero_n
        place_m.append(x_m)
        force_n.append(read_n)
        back.append(np.full(len(x_m), float(phase is pressed.down)))
    x_m, f_n, down = (np.concatenate(parts) for parts in (place_m, force_n, back))
    keep = f_n > LOWEST_SHARE * f_n.max()
    if keep.sum() < LEAST_PLACES:
        raise BenchError(f"only {keep.sum()} places of the ramp press; at least {LEAST_PLACES}")
    x_m, f_n, down = x_m[keep], f_n[keep], down[keep]
    rubber_m = np.array([law.position(f) - f * law.finger_m_per_n for f in f_n.tolist()])
    columns = np.stack([np.ones_like(x_m), -down, f_n], axis=1)
    found, *_ = np.linalg.lstsq(columns, x_m - rubber_m)
    off_m = x_m - rubber_m - columns @ found
    covariance = np.linalg.inv(columns.T @ columns) * (off_m @ off_m) / (len(x_m) - 3)
    touch_m, play_m, softness = found.tolist()
    within = WITHIN * np.sqrt(np.diag(covariance))
    if softness <= 0:
        raise BenchError("the tip presses harder than the scene's rubber alone can; look at layer")
    return ContactFit(
        finger_n_per_m=1 / softness,
        finger_within=float(within[2] / softness**2),
        touch_m=touch_m,
        touch_within=float(within[0]),
        play_m=play_m,
        play_within=float(within[1]),
        unexplained=float(np.std(off_m) / np.std(x_m)),
    )


def through_film(told: ActuatorInput, film: FilmTable) -> ActuatorInput:
    """Return an input behind the film's filter; as it is where there is none."""
    from scipy.signal import lfilter, lfilter_zi, ss2tf

    low_pass = film.low_pass(told.tick_s)
    if low_pass is None:
        return told
    (over,), under = ss2tf(low_pass.a, low_pass.b, low_pass.c, low_pass.d)
    settled = lfilter_zi(over, under) * told.values[0]
    return ActuatorInput(lfilter(over, under, told.values, zi=settled)[0], told.tick_s, told.held)


def _together(at_s: Array, values: Array) -> Array:
    """Means over stretches of TOGETHER_S."""
    _, where = np.unique(np.floor(at_s / TOGETHER_S), return_inverse=True)
    return np.asarray(np.bincount(where, values) / np.bincount(where))
