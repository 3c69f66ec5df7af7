"""The observer: how hard the finger is pressed now, from a film that is slow, noisy and coarse.

A twin of the actuator makes every commanded step and says where the tip is; a model of the
film's filter says what the film should read then. What it reads instead tells what the twin
cannot know: where the finger is and how soft. So the film's lag is undone by its model, its
noise weighs as much as an extended Kalman filter grants it, and a finger softer or stiffer
than the scene says is learnt within a few beats.
"""

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from display_node.plant.contact import ContactLaw
from display_node.plant.film import FilmTable
from display_node.plant.filters import DelayLine
from display_node.plant.stepper import Stepper
from protocol.config.quantities import Metres, Ratio
from protocol.config.scene import Section

# The force at which the gains are designed: a pulse's usual mean.
DESIGN_FORCE_N = 0.3
# A finger further off than this is another finger.
MAX_OFFSET_M = 1e-3
# What is known of finger and place before the first reading, RMS; never known less later.
FIRST_OFFSET_M = 1e-4
FIRST_SOFTNESS = 0.3
SOFTNESS_RANGE = (0.2, 5.0)
# The compliance is learnt where its error is down to this share of the first guess's.
LEARNT = 0.5
LEAST_FORCE_N = 0.01
# A reading further off than so many standard deviations is trusted no more than this one.
OUTLIER = 8.0


class ObserverScene(Section):
    """The `observer` table.

    wander: by how much the finger moves under the tip in 1 s, RMS; softening: by which share
    its compliance changes in 1 s, RMS (0: it is what the scene says).
    """

    wander_m: Annotated[Metres, Field(gt=0, le=0.1)]
    softening: Annotated[Ratio, Field(ge=0, le=1)] = 0.01


def observer_gains(
    film: FilmTable, wander_n: float, least_noise_n: float, tick_s: float
) -> tuple[float, list[float]]:
    """Stationary Kalman gains for the offset, as a force, and for the film filter's states:
    what the observer settles to on a finger whose compliance it knows.

    wander_n: RMS change of the offset in 1 s; least_noise_n: RMS of what a reading is off by
    at least (a microstep). Gains are per newton of innovation, for the next tick's state.
    Solves the discrete algebraic Riccati equation of x = (offset, filter states), the offset
    a random walk.
    """
    from scipy.linalg import solve_discrete_are

    low_pass = film.low_pass(tick_s)
    states = 1 + (film.filter_order if low_pass is not None else 0)
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
    """Follows the actuator by its commands, and the finger by what the film says.

    The states of its Kalman filter: offset of the finger in m, its compliance in m/N (which is
    the contact law's own), and those of the film's filter.

    twin: the actuator as if commands were obeyed at once; latency_ticks: from a command to the
    reading that tells of it, the filter's own lag apart.
    """

    def __init__(
        self,
        scene: ObserverScene,
        twin: Stepper,
        law: ContactLaw,
        film: FilmTable,
        step_m: float,
        tick_s: float,
        latency_ticks: float = 0.0,
    ) -> None:
        self._twin = twin
        self._law = law
        self._late = DelayLine(latency_ticks) if latency_ticks else None
        self._heard_m = 0.0
        self._low_pass = low_pass = film.low_pass(tick_s)
        self._softness_m_per_n = softness = law.finger_m_per_n
        states = 2 + (film.filter_order if low_pass is not None else 0)
        self._a, self._c, self._through = np.eye(states), np.zeros(states), 1.0
        if low_pass is not None:
            self._a[2:, 2:], self._c[2:] = low_pass.a, low_pass.c[0]
            self._through = float(low_pass.d[0, 0])
        first = [FIRST_OFFSET_M, FIRST_SOFTNESS * softness if scene.softening else 0.0]
        self._first = np.array(first) ** 2
        self._spread = np.zeros((states, states))
        self._spread[0, 0], self._spread[1, 1] = self._first
        self._growth = np.array([scene.wander_m, scene.softening * softness]) ** 2 * tick_s
        step_n = step_m * law.stiffness(DESIGN_FORCE_N)
        self._noise = film.noise_with_adc_n**2 + step_n**2 / 12
        self._offset_m = 0.0
        self.force_n = 0.0

    @property
    def screw_m(self) -> float:
        """Commanded travel of the screw from where the tip touches the finger."""
        return self._twin.screw_m + self._offset_m

    @property
    def finger_stiffness(self) -> float | None:
        """Learnt stiffness of the finger, as a factor of the scene's; None while it is a guess."""
        if self._spread[1, 1] >= (LEARNT * self._first[1] ** 0.5) ** 2:
            return None
        return self._softness_m_per_n / self._law.finger_m_per_n

    def correct(self, reading_n: float) -> None:
        """Take the film's reading at this tick; one that is no number is passed over."""
        force_n, low_pass = self._heard_n, self._low_pass
        expected_n = force_n if low_pass is None else low_pass.output(force_n)
        error_n = reading_n - expected_n
        if low_pass is not None:
            low_pass.advance(force_n)
        if math.isfinite(error_n):
            self._believe(self._weigh(error_n, force_n))

    def skip(self) -> None:
        """A tick without a reading: the film's filter goes on all the same."""
        if self._low_pass is not None:
            self._low_pass.advance(self._heard_n)

    def move(self, rate_hz: float) -> None:
        """Run the twin for one tick at a signed step rate in Hz."""
        tip_m = self._twin.move(rate_hz)
        self._heard_m = tip_m if self._late is None else self._late.step(tip_m)
        self.force_n = self._law.force(tip_m + self._offset_m)

    def shift(self, way_m: float) -> None:
        """The actuator has gone so much further than the last command says."""
        self._twin.shift(way_m)
        if self._late is not None:
            self._late.shift(way_m)

    @property
    def _heard_n(self) -> float:
        """The force that the film should tell of now: the tip's of then, the finger's of now."""
        if self._late is None:
            return self.force_n
        return self._law.force(self._heard_m + self._offset_m)

    def _weigh(self, error_n: float, force_n: float) -> list[float]:
        """One step of the Kalman filter: what the reading's error says of each state, round the
        force that it should have been."""
        a, c, spread = self._a, self._c, self._spread
        force_n = max(force_n, LEAST_FORCE_N)
        stiffness = self._law.stiffness(force_n)
        # The force's slope by offset and by compliance, at the filter's input.
        slopes = stiffness, -force_n * stiffness
        c[0], c[1] = self._through * slopes[0], self._through * slopes[1]
        if self._low_pass is not None:
            into = self._low_pass.b[:, 0]
            a[2:, 0], a[2:, 1] = into * slopes[0], into * slopes[1]
        heard = spread @ c
        variance = float(c @ heard) + self._noise
        spread = a @ (spread - np.outer(heard, heard) / variance) @ a.T
        self._spread = spread = (spread + spread.T) / 2
        # Unobserved, the spread grows, but never beyond what it was at first.
        for state in (0, 1):
            if spread[state, state] < self._first[state]:
                spread[state, state] += self._growth[state]
        bound_n = OUTLIER * math.sqrt(variance)
        error_n = min(max(error_n, -bound_n), bound_n)
        shares: list[float] = (a @ heard * (error_n / variance)).tolist()
        return shares

    def _believe(self, changes: list[float]) -> None:
        """Take over what the filter says of offset, compliance and the film's filter."""
        offset_m = self._offset_m + changes[0]
        self._offset_m = min(max(offset_m, -MAX_OFFSET_M), MAX_OFFSET_M)
        law, softness = self._law, self._softness_m_per_n
        least, most = SOFTNESS_RANGE
        learnt = law.finger_m_per_n + changes[1]
        law.finger_m_per_n = min(max(learnt, least * softness), most * softness)
        if self._low_pass is not None:
            self._low_pass.correct(changes[2:], 1.0)
