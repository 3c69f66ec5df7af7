"""A physical stepper: microsteps on a lead screw, pressing through rubber on a fingertip.

It models the path from the commanded speed to the tip: step rate (the paper's VCO), screw, rotor,
backlash. On a real bench, `pulse_drives/axis.py` computes the rate, and the rest is the drive's.
Defaults are those of Dargahi et al. (2008), Tables 2A and 2B: 1.8° motor, 0.1 m stroke, 0.4 m/s,
100 N.
"""

import math
from collections.abc import Callable
from typing import ClassVar

from display_node.plant.contact import ContactLaw
from display_node.plant.filters import delay_line
from display_node.plant.scene import StepperScene
from protocol.ticks import LimitCounter


class Rotor:
    """A stepper's rotor, held to the commanded position by a springy magnetic field.

    A second-order system, exact for a commanded position that is linear between ticks. The spring's
    softening near a lost step is not modelled.

    Parameters
    ----------
    resonance_hz
        Resonance in Hz.
    damping
        Damping ratio ζ.

    Attributes
    ----------
    position_m
        Position in screw travel at the last tick's end.
    """

    STATE: ClassVar = ("position_m", "_speed_m_per_s")

    def __init__(self, resonance_hz: float, damping: float, tick_s: float) -> None:
        import numpy as np
        from scipy.linalg import expm

        w = 2 * math.pi * resonance_hz
        system = np.zeros((4, 4))
        system[0, 1] = system[2, 3] = 1.0
        system[1, :3] = -w * w, -2 * damping * w, w * w
        moved = expm(system * tick_s)
        # The command's slope is its travel over the tick.
        moved[:, 3] /= tick_s
        self._position, self._speed = moved[0].tolist(), moved[1].tolist()
        self.position_m = 0.0
        self._speed_m_per_s = 0.0

    def step(self, from_m: float, to_m: float) -> float:
        """Return the rotor's position after a tick that commands from_m to to_m."""
        x, v, travel = self.position_m, self._speed_m_per_s, to_m - from_m
        a, b, c, d = self._position
        self.position_m = a * x + b * v + c * from_m + d * travel
        a, b, c, d = self._speed
        self._speed_m_per_s = a * x + b * v + c * from_m + d * travel
        return self.position_m


class Backlash:
    """A gap of width_m in m: the driven side moves only when a flank of the gap touches it.

    This is the worst case, in which no force presses the nut to one flank of the thread.
    """

    def __init__(self, width_m: float) -> None:
        self._half_m = width_m / 2
        self._driven_m = 0.0

    def step(self, driving_m: float) -> float:
        """Return the driven side's position for the driving side's."""
        half_m = self._half_m
        if driving_m > self._driven_m + half_m:
            self._driven_m = driving_m - half_m
        elif driving_m < self._driven_m - half_m:
            self._driven_m = driving_m + half_m
        return self._driven_m


class Stepper:
    """A stepper that counts microsteps and presses with its tip.

    A soft stop holds the screw where the tip would press with the force limit. A rotor that
    oscillates moves the tip beyond it, and backlash may keep the tip there; the overforce fault
    of `ForceBounds` bounds the force. Lost steps and the screw's elasticity are not modelled.

    Parameters
    ----------
    force_limit_n
        Force in N at the soft stop.
    linear
        Leave out microsteps, soft stop and backlash, for a loop's linear model.
    steps_per_m
        Factor of the VCO, from a speed in m/s to a step rate in Hz; None for that of the scene. The
        rate's sign is the direction line; it is positive into the finger.

    Attributes
    ----------
    tip_m
        Tip position in m from first touch, positive into the finger.
    force_n
        Force in N at the last tick's end.
    at_end
        Counter of the ticks in which the soft stop has held the screw.
    """

    STATE: ClassVar = ("_phase", "_late", "_rotor", "tip_m")

    def __init__(
        self,
        scene: StepperScene,
        law: ContactLaw,
        force_limit_n: float,
        tick_s: float,
        linear: bool = False,
        steps_per_m: float | None = None,
    ) -> None:
        self._law = law
        self._steps_per_m = scene.steps_per_m if steps_per_m is None else steps_per_m
        self._step_m = scene.step_m
        self._tick_s = tick_s
        self._max_rate_hz = scene.max_speed_m_per_s / scene.step_m
        self._max_change_hz = scene.max_acceleration_m_per_s2 / scene.step_m * tick_s
        self._whole: Callable[[float], float] = round
        self._backlash: Backlash | None = None
        if scene.backlash_m and not linear:
            self._backlash = Backlash(scene.backlash_m)
        self._first_step, self._last_step = -math.inf, math.inf
        if linear:
            self._whole = float
            self._max_rate_hz = self._max_change_hz = math.inf
        else:
            # To take up the backlash, the screw may move half of it beyond the soft stop, and
            # all of it below home.
            furthest_m = min(scene.stroke_m, law.position(min(scene.thrust_n, force_limit_n)))
            self._first_step = -float(math.ceil(scene.backlash_m / scene.step_m))
            self._last_step = float(math.floor((furthest_m + scene.backlash_m / 2) / scene.step_m))
        self._rotor: Rotor | None = None
        if scene.rotor_resonance_hz is not None:
            self._rotor = Rotor(scene.rotor_resonance_hz, scene.rotor_damping, tick_s)
        self._late = delay_line(scene.latency_ns * 1e-9 / tick_s)
        # Cache: on whole microsteps, the tip returns to the same positions.
        self._forces_n: dict[float, float] = {}
        self._phase = 0.0
        self._rate_hz = 0.0
        self.tip_m = 0.0
        self.force_n = 0.0
        self.at_end = LimitCounter()

    @property
    def screw_m(self) -> float:
        """Commanded travel in m from first touch, including fractions of a microstep."""
        return self._phase * self._step_m

    def step(self, speed_m_per_s: float) -> float:
        """Run one tick at a commanded speed in m/s; return the force in N at its end."""
        position_m, forces_n = self.move(speed_m_per_s), self._forces_n
        force_n = forces_n.get(position_m)
        if force_n is None:
            force_n = self._law.force(position_m)
            if self._rotor is None:
                forces_n[position_m] = force_n
        self.force_n = force_n
        return force_n

    def move(self, speed_m_per_s: float) -> float:
        """Run one tick without the contact; return the tip's position in m at its end."""
        # The paper's VCO.
        rate_hz = speed_m_per_s * self._steps_per_m
        # Comparisons, and no calls of `min` and `max`: this runs each tick.
        max_hz, last_hz, change_hz = self._max_rate_hz, self._rate_hz, self._max_change_hz
        if rate_hz > max_hz:
            rate_hz = max_hz
        elif rate_hz < -max_hz:
            rate_hz = -max_hz
        if self._late is not None:
            rate_hz = self._late.step(rate_hz)
        if rate_hz > last_hz + change_hz:
            rate_hz = last_hz + change_hz
        elif rate_hz < last_hz - change_hz:
            rate_hz = last_hz - change_hz
        before, phase = self._phase, self._phase + rate_hz * self._tick_s
        at_end = phase > self._last_step
        if at_end or self.at_end.active:
            self.at_end.add(at_end)
        if not self._first_step <= phase <= self._last_step:
            phase = self._last_step if at_end else self._first_step
            rate_hz = 0.0
        self._phase, self._rate_hz = phase, rate_hz
        whole = self._whole
        position_m = whole(phase) * self._step_m
        if self._rotor is not None:
            position_m = self._rotor.step(whole(before) * self._step_m, position_m)
        if self._backlash is not None:
            position_m = self._backlash.step(position_m)
        self.tip_m = position_m
        return position_m

    def place(self, position_m: float) -> None:
        """Put screw, rotor and tip at rest at a position, in m from first touch."""
        self._phase, self.tip_m = position_m / self._step_m, position_m
        if self._rotor is not None:
            self._rotor.position_m = position_m

    def shift(self, travel_m: float) -> None:
        """Add a travel of the screw in m that the last command did not include."""
        self._phase += travel_m / self._step_m
