"""The observer: how hard the finger is pressed now, from a film that is slow, noisy and coarse.

A twin of the actuator makes every commanded step and says where the tip is; a twin of the
film's filter says what the film should read then. What it reads instead moves the one thing
that the twins cannot know: where the finger is. So the film's lag is undone by its model, and
its noise weighs as much as a Kalman filter grants it.
"""

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from display_node.actuators.contact import ContactLaw
from display_node.actuators.stepper import Stepper
from display_node.film import FilmTable
from display_node.step_rate import StepCommand
from protocol.quantities import Metres
from protocol.scene import Section

# The force at which the gains are designed: a pulse's usual mean.
DESIGN_FORCE_N = 0.3
# A finger further off than this is another finger.
MAX_OFFSET_M = 1e-3
LEAST_FORCE_N = 0.01


class ObserverScene(Section):
    """The `observer` table. wander: by how much the finger moves under the tip in 1 s, RMS."""

    wander_m: Annotated[Metres, Field(gt=0, le=0.1)]


def observer_gains(
    film: FilmTable, wander_n: float, least_noise_n: float, tick_s: float
) -> tuple[float, list[float]]:
    """Stationary Kalman gains for the offset, as a force, and for the film filter's states.

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
    """Follows the actuator by its commands, and the finger by what the film says."""

    def __init__(
        self,
        scene: ObserverScene,
        twin: Stepper,
        law: ContactLaw,
        film: FilmTable,
        step_m: float,
        tick_s: float,
    ) -> None:
        self._twin = twin
        self._law = law
        self._low_pass = film.low_pass(tick_s)
        stiffness = law.stiffness(DESIGN_FORCE_N)
        self._offset_gain, self._filter_gains = observer_gains(
            film, scene.wander_m * stiffness, step_m * stiffness / math.sqrt(12), tick_s
        )
        self._offset_m = 0.0
        self.force_n = 0.0

    @property
    def screw_m(self) -> float:
        """Commanded travel of the screw from where the tip touches the finger."""
        return self._twin.screw_m + self._offset_m

    def correct(self, reading_n: float) -> None:
        """Take the film's reading at this tick; one that is no number is passed over."""
        force_n, low_pass = self.force_n, self._low_pass
        expected_n = force_n if low_pass is None else low_pass.output(force_n)
        error_n = reading_n - expected_n
        if low_pass is not None:
            low_pass.advance(force_n)
        if not math.isfinite(error_n):
            return
        if low_pass is not None:
            low_pass.correct(self._filter_gains, error_n)
        stiffness = self._law.stiffness(max(force_n, reading_n, LEAST_FORCE_N))
        offset_m = self._offset_m + self._offset_gain * error_n / stiffness
        self._offset_m = min(max(offset_m, -MAX_OFFSET_M), MAX_OFFSET_M)

    def move(self, command: StepCommand) -> None:
        """The actuator runs one tick as commanded."""
        self.force_n = self._law.force(self._twin.move(command) + self._offset_m)
