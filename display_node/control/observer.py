"""Observer of the present force, from a film that is slow, noisy and coarse.

A model of the actuator (the twin) receives every command and gives the tip's position; a model of
the film's filter gives the expected reading. An extended Kalman filter estimates the finger's place
and compliance from the difference to the actual reading. So the film's lag is compensated, and a
finger softer or stiffer than the scene's is learnt within a few beats (decision 8).
"""

import math
from typing import ClassVar

import numpy as np

from display_node.control.scene import ObserverScene
from display_node.plant.contact import ContactLaw
from display_node.plant.filters import delay_line
from display_node.plant.scene import FilmTable
from display_node.plant.stepper import Stepper

# The force at which the gains are designed: a pulse's usual mean.
DESIGN_FORCE_N = 0.3
# Bound of the finger's estimated offset.
MAX_OFFSET_M = 1e-3
# RMS uncertainty of the finger's place and compliance before the first reading; it never exceeds
# this.
FIRST_OFFSET_M = 1e-4
FIRST_SOFTNESS = 0.3
SOFTNESS_RANGE = (0.2, 5.0)
# The compliance counts as learnt when its error has fallen to this share of the first one.
LEARNT = 0.5
LEAST_FORCE_N = 0.01
# Innovations are clipped to this number of standard deviations.
OUTLIER = 8.0


def observer_gains(
    film: FilmTable, wander_n: float, least_noise_n: float, tick_s: float
) -> tuple[float, list[float]]:
    """Return the observer's stationary gains for a finger of known compliance.

    Solves the discrete algebraic Riccati equation for the states (offset, filter states), where the
    offset is a random walk.

    Parameters
    ----------
    film
        The film, with its filter and noise.
    wander_n
        RMS change of the offset in 1 s, as a force in N.
    least_noise_n
        RMS of a reading's least error in N (a microstep).

    Returns
    -------
    tuple
        Kalman gains per newton of innovation, for the next tick's offset (as a force) and filter
        states.
    """
    from scipy.linalg import solve_discrete_are

    low_pass = film.low_pass(tick_s)
    states = 1 + (0 if low_pass is None else film.filter_order)
    a, c = np.eye(states), np.ones((1, states))
    if low_pass is not None:
        a[1:, 1:], a[1:, :1] = low_pass.a, low_pass.b
        c[0, 0], c[0, 1:] = low_pass.d[0, 0], low_pass.c[0]
    drift = np.zeros((states, states))
    drift[0, 0] = wander_n**2 * tick_s
    noise = np.array([[film.noise_with_adc_n**2 + least_noise_n**2]])
    spread = solve_discrete_are(a.T, c.T, drift, noise)
    gains = (a @ spread @ c.T / (c @ spread @ c.T + noise))[:, 0].tolist()
    return gains[0], gains[1:]


class Observer:
    """A Kalman filter of the finger's state under an actuator whose commands are known.

    Its states are the finger's offset in m, its compliance in m/N (stored in the contact law), and
    the states of the film's filter.

    Parameters
    ----------
    twin
        The actuator without latency.
    law
        Contact law; its `finger_m_per_n` is learnt.
    step_m
        Microstep in m.
    latency_ticks
        Ticks from a command to the reading that shows it, besides the filter's lag.
    gains
        Fixed gains as of `observer_gains`, in place of the filter's own.

    Attributes
    ----------
    force_n
        Estimated force at the last tick's end, in N.
    """

    STATE: ClassVar = ("_twin", "_late", "_low_pass", "_offset_m", "_delayed_tip_m", "force_n")

    def __init__(
        self,
        scene: ObserverScene,
        twin: Stepper,
        law: ContactLaw,
        film: FilmTable,
        step_m: float,
        tick_s: float,
        latency_ticks: float = 0.0,
        gains: tuple[float, list[float]] | None = None,
    ) -> None:
        self._twin = twin
        self._law = law
        self._gains = gains
        self._late = delay_line(latency_ticks)
        self._delayed_tip_m = 0.0
        self._low_pass = low_pass = film.low_pass(tick_s)
        self._scene_m_per_n = compliance = law.finger_m_per_n
        states = 2 + (film.filter_order if low_pass is not None else 0)
        self._a, self._c, self._through = np.eye(states), np.zeros(states), 1.0
        if low_pass is not None:
            self._a[2:, 2:], self._c[2:] = low_pass.a, low_pass.c[0]
            self._through = float(low_pass.d[0, 0])
        first = [FIRST_OFFSET_M, FIRST_SOFTNESS * compliance if scene.softening else 0.0]
        self._first = np.array(first) ** 2
        self._spread = np.zeros((states, states))
        self._spread[0, 0], self._spread[1, 1] = self._first
        self._growth = np.array([scene.wander_m, scene.softening * compliance]) ** 2 * tick_s
        step_n = step_m * law.stiffness(DESIGN_FORCE_N)
        self._noise = film.noise_with_adc_n**2 + step_n**2 / 12
        self._offset_m = 0.0
        self.force_n = 0.0

    @property
    def screw_m(self) -> float:
        """Commanded travel of the screw in m from where the tip touches the finger."""
        return self._twin.screw_m + self._offset_m

    @property
    def finger_stiffness(self) -> float | None:
        """Learnt stiffness of the finger, as a factor of the scene's; None while it is a guess."""
        if self._spread[1, 1] >= (LEARNT * self._first[1] ** 0.5) ** 2:
            return None
        return self._scene_m_per_n / self._law.finger_m_per_n

    def correct(self, reading_n: float) -> None:
        """Take the film's reading at this tick in N; one that is no number is ignored."""
        force_n, low_pass = self._delayed_force_n, self._low_pass
        expected_n = force_n if low_pass is None else low_pass.output(force_n)
        error_n = reading_n - expected_n
        if low_pass is not None:
            low_pass.advance(force_n)
        if not math.isfinite(error_n):
            return
        if self._gains is None:
            changes = self._changes(error_n, force_n)
        else:
            offset_gain, filter_gains = self._gains
            changes = [offset_gain * error_n, 0.0, *(gain * error_n for gain in filter_gains)]
        offset_m = self._offset_m + changes[0]
        self._offset_m = min(max(offset_m, -MAX_OFFSET_M), MAX_OFFSET_M)
        law, nominal = self._law, self._scene_m_per_n
        least, most = SOFTNESS_RANGE
        learnt = law.finger_m_per_n + changes[1]
        law.finger_m_per_n = min(max(learnt, least * nominal), most * nominal)
        if low_pass is not None:
            low_pass.correct(changes[2:])

    def skip(self) -> None:
        """Advance the film's filter over a tick without a reading."""
        if self._low_pass is not None:
            self._low_pass.advance(self._delayed_force_n)

    def move(self, speed_m_per_s: float) -> None:
        """Run the twin for one tick at a commanded speed in m/s."""
        tip_m = self._twin.move(speed_m_per_s)
        self._delayed_tip_m = tip_m if self._late is None else self._late.step(tip_m)
        self.force_n = self._law.force(tip_m + self._offset_m)

    def shift(self, travel_m: float) -> None:
        """Add a travel of the screw in m that the last command did not include."""
        self._twin.shift(travel_m)
        if self._late is not None:
            self._late.shift(travel_m)

    @property
    def _delayed_force_n(self) -> float:
        """Expected reading before the filter: from the delayed tip and the present finger."""
        return self._law.force(self._delayed_tip_m + self._offset_m)

    def _changes(self, error_n: float, force_n: float) -> list[float]:
        """Return one Kalman step's changes of the states, linearised at the expected force."""
        a, c, spread = self._a, self._c, self._spread
        force_n = max(force_n, LEAST_FORCE_N)
        stiffness = self._law.stiffness(force_n)
        # The force's slope by offset and by compliance, at the filter's input.
        slopes = stiffness, -force_n * stiffness
        c[0], c[1] = self._through * slopes[0], self._through * slopes[1]
        if self._low_pass is not None:
            into = self._low_pass.b[:, 0]
            a[2:, 0], a[2:, 1] = into * slopes[0], into * slopes[1]
        covariance = spread @ c
        variance = float(c @ covariance) + self._noise
        spread = a @ (spread - np.outer(covariance, covariance) / variance) @ a.T
        self._spread = spread = (spread + spread.T) / 2
        # Without information the uncertainty grows, but never beyond the initial one.
        for state in (0, 1):
            if spread[state, state] < self._first[state]:
                spread[state, state] += self._growth[state]
        bound_n = OUTLIER * math.sqrt(variance)
        error_n = min(max(error_n, -bound_n), bound_n)
        changes: list[float] = (a @ covariance * (error_n / variance)).tolist()
        return changes
