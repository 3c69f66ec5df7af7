"""A planned press: a slow ramp up and down, then a staircase of small steps.

All steps have one direction, so that they cross no backlash, and irregular dwells, so that they
excite all frequencies. The film is checked at every tick: above a limit the press ends at once. The
ramp determines the contact: stiffness, first touch and backlash.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from display_node.plant.contact import ContactLaw
from display_node.plant.scene import FilmTable, SecondOrderScene, StepperScene
from protocol.errors import BenchError, DriveError
from telepulse.commissioning.identification import DEVIATIONS_95, ActuatorInput, Array
from telepulse.commissioning.rig import Rig

STILL_S = 1.0
# Rate of the slow ramp; the finger's stiffness in the scene converts it to a speed.
RAMP_N_PER_S = 0.2
# Largest travel of the slow ramp.
SEARCH_M = 3e-3
# Readings below this share of the largest force are not used: the contact is uncertain there.
LOWEST_SHARE = 0.1
STEPS = 12
DWELL_S = (0.08, 0.2)
SEED = 1
# Shortest rise of a step in ticks: it averages the small timing errors of a drive's commands.
LEAST_RISE = 3
# Dwell in periods of the second-order model, and the smallest stiffness for its period.
SLOW_DWELL = (0.2, 1.0)
LEAST_K = 1e-3
# The press ends at this multiple of the largest planned force.
GUARD = 1.5
# Readings over this time are averaged to one point of the ramp, which reduces the film's noise.
PLACE_S = 0.01
LEAST_PLACES = 8


class PressPhase(NamedTuple):
    """A part of a press, by its times on the rig's clock."""

    begin_s: float
    end_s: float


@dataclass(slots=True)
class PressRecorder:
    """Recorder of a rig's outputs and readings while it is driven.

    A reading above max_n, or no reading for max_silent_s, withdraws the rig and raises BenchError.
    A press sets its phases: still, the ramp of a stepper up and down, and the staircase.
    """

    rig: Rig
    max_n: float
    max_silent_s: float
    commanded_s: list[float] = field(default_factory=list)
    output: list[float] = field(default_factory=list)
    film_s: list[float] = field(default_factory=list)
    film_n: list[float] = field(default_factory=list)
    zero_n: float = 0.0
    still: PressPhase = field(init=False)
    up: PressPhase = field(init=False)
    down: PressPhase = field(init=False)
    stairs: PressPhase = field(init=False)

    def run(self, outputs: Iterable[float]) -> None:
        """Command one output per tick."""
        for output in outputs:
            commanded_s, samples = self.rig.tick(output)
            self.commanded_s.append(commanded_s)
            self.output.append(output)
            for time_s, force_n in samples:
                self.film_s.append(time_s)
                self.film_n.append(force_n)
                if not abs(self.force_n) <= self.max_n:
                    self._stop(f"the film reads {self.force_n:.3g} N, above {self.max_n:.3g} N")
            last_s = self.film_s[-1] if self.film_s else self.commanded_s[0]
            if commanded_s - last_s > self.max_silent_s:
                self._stop(f"no reading of the film for {self.max_silent_s * 1e3:.0f} ms")

    def hold(self, seconds: float) -> None:
        """Command 0 for a time."""
        self.run([0.0] * round(seconds / self.rig.tick_s))

    @property
    def force_n(self) -> float:
        """Last reading of the film, above its zero."""
        return self.film_n[-1] - self.zero_n if self.film_n else 0.0

    @property
    def now_s(self) -> float:
        """Time of the last command."""
        return self.commanded_s[-1]

    @property
    def travel_m(self) -> Array:
        """Travel of the screw at each command since the first."""
        return np.concatenate([[0.0], np.cumsum(self.output[:-1] * np.diff(self.commanded_s))])

    def film(self, phase: PressPhase) -> tuple[Array, Array]:
        """Return times in s from the begin of the phase, and readings in N with their zero."""
        time_s, force_n = np.array(self.film_s), np.array(self.film_n)
        inside = (time_s >= phase.begin_s) & (time_s <= phase.end_s)
        return time_s[inside] - phase.begin_s, force_n[inside]

    def command(self, phase: PressPhase, held: bool = False) -> ActuatorInput:
        """Return the commands of a phase, one a tick.

        held: return the outputs, such as voltages; otherwise the travel of the screw in m, which is
        linear in time between two commands.
        """
        tick_s = self.rig.tick_s
        count = round((phase.end_s - phase.begin_s) / tick_s) + 1
        grid_s = phase.begin_s + tick_s * np.arange(count)
        if held:
            last = np.searchsorted(self.commanded_s, grid_s + tick_s / 2) - 1
            return ActuatorInput(np.array(self.output)[np.maximum(last, 0)], tick_s, held=True)
        travel_m = np.interp(grid_s, self.commanded_s, self.travel_m)
        return ActuatorInput(travel_m, tick_s, held=False)

    def _stop(self, reason: str) -> None:
        try:
            self.rig.withdraw()
        except DriveError as error:
            raise BenchError(f"the press was stopped: {reason}; {error}") from None
        raise BenchError(f"the press was stopped and the tip went back: {reason}")


def press_stepper(recorder: PressRecorder, scene: StepperScene, force_n: float) -> None:
    """Press with at most about force_n, and end where the press began. Raises BenchError.

    The scene gives the drive's acceleration; its finger sets the speed of the slow ramp.
    """
    _hold_still(recorder)
    slow = RAMP_N_PER_S / scene.fingertip_n_per_m
    low_n = LOWEST_SHARE * force_n
    recorder.up = up = _ramp(recorder, slow, force_n)
    recorder.down = _ramp(recorder, -slow, low_n / 2)
    _ramp(recorder, slow, low_n)
    # Each step is a share of the ramp's travel from the low force to its end.
    (at_s, read_n), travel = recorder.film(up), recorder.command(up)
    below = np.flatnonzero(read_n - recorder.zero_n < low_n)
    from_s = at_s[below[-1]] if len(below) else 0.0
    pressing_m = float(travel.values[-1] - np.interp(from_s, travel.time_s, travel.values))
    step_m = pressing_m / STEPS
    begin_s, rng, tick_s = recorder.now_s, np.random.default_rng(SEED), recorder.rig.tick_s
    for _ in range(STEPS):
        recorder.hold(rng.uniform(*DWELL_S))
        recorder.run(profile(step_m, scene.max_acceleration_m_per_s2 / 2, tick_s))
    recorder.hold(DWELL_S[1])
    recorder.stairs = PressPhase(begin_s, recorder.now_s)
    # Back to where the press began.
    travel_m = float(recorder.travel_m[-1])
    ticks = max(1, math.ceil(abs(travel_m) / (10 * slow) / tick_s))
    recorder.run([-travel_m / (ticks * tick_s)] * ticks)
    recorder.hold(STILL_S / 4)


def press_voltage(recorder: PressRecorder, scene: SecondOrderScene, force_n: float) -> None:
    """Press by a staircase of voltages, as slow as the scene's model. Raises BenchError."""
    _hold_still(recorder)
    begin_s, rng = recorder.now_s, np.random.default_rng(SEED)
    tick_s, stiffness = recorder.rig.tick_s, max(scene.k, LEAST_K)
    period_s = 2 * math.pi * math.sqrt(scene.m / stiffness)
    for step in range(1, STEPS + 1):
        # At most half of the force: the model may swing to twice a step.
        volts = stiffness * force_n * step / (2 * STEPS)
        recorder.run([volts] * max(1, round(rng.uniform(*SLOW_DWELL) * period_s / tick_s)))
    recorder.stairs = PressPhase(begin_s, recorder.now_s)
    recorder.hold(period_s)


def profile(travel_m: float, acceleration_m_per_s2: float, tick_s: float) -> list[float]:
    """Return speeds in m/s, one per tick, for a travel from rest to rest (triangular profile)."""
    rise = max(LEAST_RISE, math.ceil(math.sqrt(abs(travel_m) / acceleration_m_per_s2) / tick_s))
    shape = [*range(1, rise + 1), *range(rise - 1, 0, -1)]
    return [travel_m / (sum(shape) * tick_s) * part for part in shape]


def _hold_still(recorder: PressRecorder) -> None:
    begin = len(recorder.commanded_s)
    # No reading ends the press before the film's zero is known.
    guard, recorder.max_n = recorder.max_n, math.inf
    recorder.hold(STILL_S)
    if not recorder.film_n:
        raise BenchError("no reading of the film")
    recorder.zero_n, recorder.max_n = float(np.mean(recorder.film_n)), guard
    recorder.still = PressPhase(recorder.commanded_s[begin], recorder.now_s)


def _ramp(recorder: PressRecorder, speed_m_per_s: float, until_n: float) -> PressPhase:
    """Move slowly until the film is past a force."""
    begin_s = recorder.now_s
    for _ in range(round(SEARCH_M / abs(speed_m_per_s) / recorder.rig.tick_s)):
        recorder.run([speed_m_per_s])
        if (recorder.force_n - until_n) * speed_m_per_s >= 0:
            return PressPhase(begin_s, recorder.now_s)
    recorder.run([0.0])
    recorder.rig.withdraw()
    where = "nothing was touched" if speed_m_per_s > 0 else "the film is still pressed"
    raise BenchError(
        f"{where} on {SEARCH_M * 1e3:.0f} mm of travel: the film reads"
        f" {recorder.force_n * 1e3:.0f} mN; check the film, the drive's direction and `touch`"
    )


@dataclass(frozen=True, slots=True)
class ContactFit:
    """Contact under the actuator; half-widths: the 95 % interval of a value, to either side.

    touch_m: place of first touch, from where the press began. backlash_m: below 0, the force on
    the way out exceeds that on the way in. unexplained: RMS of the fit's residuals, as a share of
    the standard deviation of the places.
    """

    finger_n_per_m: float
    finger_half_width: float
    touch_m: float
    backlash_m: float
    backlash_half_width: float
    unexplained: float

    @property
    def has_backlash(self) -> bool:
        """True where the backlash is surely above 0."""
        return self.backlash_m > 2 * self.backlash_half_width

    def pressed_n(self, law: ContactLaw, travel: ActuatorInput) -> ActuatorInput:
        """Return the force at rest at each place of the screw, on its way in."""
        tip_m = travel.values - self.touch_m
        force_n = np.array([law.force(x) for x in tip_m.tolist()])
        return ActuatorInput(force_n, travel.tick_s, held=False)


def fit_contact(
    pressed: PressRecorder, law: ContactLaw, film: FilmTable, lag_s: float
) -> ContactFit:
    """Fit x = touch − backlash · [going back] + rubber F^(2/3) + F / finger by least squares.

    The rubber's part is the law's. lag_s: from a command to the film's reading, without the
    film's filter, which is compensated here. Raises BenchError for a record with too few places.
    """
    both = PressPhase(pressed.up.begin_s, pressed.down.end_s)
    seen_m = through_film(pressed.command(both), film)
    place_m, force_n, back = [], [], []
    for phase in (pressed.up, pressed.down):
        at_s, read_n = pressed.film(phase)
        late_s = at_s + phase.begin_s - both.begin_s - lag_s
        _, stretch = np.unique(np.floor(at_s / PLACE_S), return_inverse=True)
        count = np.bincount(stretch)
        late_m = np.interp(late_s, seen_m.time_s, seen_m.values)
        place_m.append(np.bincount(stretch, late_m) / count)
        force_n.append(np.bincount(stretch, read_n) / count - pressed.zero_n)
        back.append(np.full(len(place_m[-1]), float(phase is pressed.down)))
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
    touch_m, backlash_m, softness = found.tolist()
    half_widths = DEVIATIONS_95 * np.sqrt(np.diag(covariance))
    if softness <= 0:
        raise BenchError("the force is larger than the scene's rubber layer allows: check `layer`")
    return ContactFit(
        finger_n_per_m=1 / softness,
        finger_half_width=float(half_widths[2] / softness**2),
        touch_m=touch_m,
        backlash_m=backlash_m,
        backlash_half_width=float(half_widths[1]),
        unexplained=float(np.std(off_m) / np.std(x_m)),
    )


def through_film(command: ActuatorInput, film: FilmTable) -> ActuatorInput:
    """Return a command after the film's filter; itself where there is none."""
    from scipy.signal import lfilter, lfilter_zi, ss2tf

    low_pass = film.low_pass(command.tick_s)
    if low_pass is None:
        return command
    (over,), under = ss2tf(low_pass.a, low_pass.b, low_pass.c, low_pass.d)
    settled = lfilter_zi(over, under) * command.values[0]
    filtered = lfilter(over, under, command.values, zi=settled)[0]
    return ActuatorInput(filtered, command.tick_s, command.held)
