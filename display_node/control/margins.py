"""Stability of a force loop: poles, margins, and its response to noise.

The classical margins are taken where the output enters the drive: a step too long or too
short, or a drive that answers late, acts there.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from display_node.control.controller import ControllerScene
from display_node.control.linear_loop import Array, LinearLoop, linear_loop
from display_node.plant.film import FilmTable
from display_node.plant.second_order import SecondOrderScene
from display_node.plant.stepper import StepperScene
from protocol.errors import SceneError
from protocol.tactile import ElasticLayer

# Forces at which a loop is judged, as shares of the force limit: hardly touching, a pulse's
# usual mean (0.3 of 2.5 N), pressing with all that is allowed.
FORCE_SHARES = (0.008, 0.12, 1.0)
FREQUENCIES = 2_000
COARSE = 400
RESPONSE_S = 4.0
# Ms above this: a tenth more gain or a little more delay, and the loop is unstable.
FRAGILE = 10.0
# Poles this close to the circle are rounding, or the slow integral of a small ki.
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Margins:
    """Stability of a loop. A margin is infinite where nothing of that kind destabilises it.

    Attributes
    ----------
    pole_radius
        Largest magnitude of a pole; below 1 is stable.
    gain
        Factor by which the gain may grow.
    phase_deg
        Phase margin in degrees.
    delay_s
        Further delay in s that the loop bears.
    peak_sensitivity
        Ms: 1 over the Nyquist curve's distance from −1.
    """

    pole_radius: float
    gain: float
    phase_deg: float
    delay_s: float
    peak_sensitivity: float

    @property
    def stable(self) -> bool:
        """True where every pole lies inside the unit circle."""
        return self.pole_radius < 1 + ROUNDING

    @property
    def unfit(self) -> str | None:
        """Reason to put no finger on this loop; None where it may."""
        if not self.stable:
            return f"is not stable (largest pole {self.pole_radius:.4g}, must be below 1)"
        if self.peak_sensitivity > FRAGILE:
            peak = f"peak sensitivity {self.peak_sensitivity:.3g}, above {FRAGILE:g}"
            return f"is hardly stable ({peak})"
        return None


def margins(loop: LinearLoop, frequencies: int = FREQUENCIES) -> Margins:
    """Return a loop's margins, by its response at so many frequencies up to half the tick rate."""
    nyquist = math.pi / loop.tick_s
    w = np.geomspace(nyquist * 1e-5, nyquist, frequencies)
    response = _cut_response(loop, w)
    phase = np.unwrap(np.angle(response))
    size = np.log(np.maximum(np.abs(response), 1e-300))
    gain, phase_rad, delay_s = math.inf, math.inf, math.inf
    turn = np.floor((phase / math.pi + 1) / 2)
    for at in np.flatnonzero(np.diff(turn)).tolist():
        opposite_rad = (2 * max(turn[at], turn[at + 1]) - 1) * math.pi
        level = math.exp(-_between(size, at, phase, opposite_rad))
        if level > 1:
            gain = min(gain, level)
    at_nyquist = float(response[-1].real)
    if -1 < at_nyquist < 0:
        gain = min(gain, -1 / at_nyquist)
    for at in np.flatnonzero(np.diff(np.sign(size))).tolist():
        over_rad = (_between(phase, at, size, 0.0) + math.pi) % (2 * math.pi)
        phase_rad = min(phase_rad, over_rad, 2 * math.pi - over_rad)
        delay_s = min(delay_s, over_rad / _between(w, at, size, 0.0))
    return Margins(
        pole_radius=float(np.max(np.abs(loop.poles()))),
        gain=gain,
        phase_deg=math.degrees(phase_rad),
        delay_s=delay_s,
        peak_sensitivity=float(np.max(1 / np.abs(1 + response))),
    )


def felt_noise(loop: LinearLoop, wander: float, noise: float) -> float:
    """Return the RMS of the tip's motion by a wandering finger and a noisy film.

    Parameters
    ----------
    loop
        The loop, whose unit all three have: m or N.
    wander
        RMS change of the finger's place in 1 s.
    noise
        RMS of a reading's error, white.
    """
    by_noise = _energy(loop, loop.closed_noise)
    by_wander = _energy(loop, loop.displaced)
    return math.sqrt(noise**2 * by_noise + wander**2 * loop.tick_s * by_wander)


def _energy(loop: LinearLoop, state: Array) -> float:
    """Return the sum of squares of the tip's motion from a state, without inputs."""
    closed, total = loop.closed, 0.0
    for _ in range(round(RESPONSE_S / loop.tick_s)):
        total += float(loop.tip @ state) ** 2
        state = closed @ state
    return total


def refuse_unstable(
    controller: ControllerScene,
    actuator: SecondOrderScene | StepperScene,
    layer: ElasticLayer,
    film: FilmTable,
    force_limit_n: float,
    tick_s: float,
) -> None:
    """Raise SceneError for a loop that is not stable enough at some force up to the limit."""
    for share in FORCE_SHARES:
        force_n = share * force_limit_n
        found = margins(linear_loop(controller, actuator, layer, film, tick_s, force_n), COARSE)
        reason = found.unfit
        if reason is not None:
            raise SceneError(
                f"[display] controller: the force loop {reason} at {force_n:.2g} N: lower its"
                " gains, or take those that `telepulse tune` proposes"
            )


def _cut_response(loop: LinearLoop, w: Array) -> NDArray[np.complex128]:
    """Return the cut loop's frequency response, negative feedback counted positive; complex."""
    z = np.exp(1j * w * loop.tick_s)
    systems = z[:, None, None] * np.eye(len(loop.a)) - loop.a
    solved = np.linalg.solve(systems, loop.b[None, :, None] + 0j)
    response: NDArray[np.complex128] = -(loop.c @ solved[:, :, 0].T)
    return response


def _between(values: Array, at: int, at_values: Array, level: float) -> float:
    """Return `values` where `at_values` crosses `level` between entries `at` and the next."""
    span = at_values[at + 1] - at_values[at]
    share = (level - at_values[at]) / span if span else 0.0
    return float(values[at] + share * (values[at + 1] - values[at]))
