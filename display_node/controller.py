"""The controller: PID and feed-forward, from the reference and the feedback film to an output.

It compares the reference force with what the PVDF film under the finger says. The output is a
voltage for the paper's second-order model and a speed for a stepper.
"""

import math
from collections.abc import Callable
from typing import Annotated, Literal

from pydantic import Field

from display_node.actuators.contact import ContactLaw
from protocol.quantities import Hertz
from protocol.scene import Section
from protocol.tactile import Film


class ControllerScene(Section):
    """The `controller` table.

    error: what the PID sees. "force" in N; "millivolts" of the film by eq 21, the reading of
    the paper's gains that follows a pulse; "position" in m through the inverse contact law,
    which makes the loop's gain the same at every force. feed_forward: drive the reference's
    own motion without waiting for an error (stepper only). derivative_filter: corner of the
    derivative's low-pass. dead_band: drive outputs below this are no motion (in the unit of
    the PID's output: V, or m/s for a stepper).
    """

    kp: Annotated[float, Field(ge=0)]
    ki: Annotated[float, Field(ge=0)] = 0.0
    kd: Annotated[float, Field(ge=0)] = 0.0
    derivative_filter_hz: Annotated[Hertz, Field(gt=0)] = 100.0
    error: Literal["force", "millivolts", "position"] = "force"
    feed_forward: bool = False
    dead_band: Annotated[float, Field(ge=0)] = 0.0


class Pid:
    """PID with a filtered derivative and clamped integral; output bounded by `limit`.

    Derivative and filter by backward Euler. The integral stands still while the output is at
    its bound and the error would push it further (anti-windup by conditional integration).
    """

    def __init__(self, scene: ControllerScene, tick_s: float, limit: float) -> None:
        filter_s = 1 / (2 * math.pi * scene.derivative_filter_hz)
        self._kp, self._ki_tick = scene.kp, scene.ki * tick_s
        self._keep = filter_s / (filter_s + tick_s)
        self._kd_tick = scene.kd / (filter_s + tick_s)
        self._limit = limit
        self._integral = 0.0
        self._derivative = 0.0
        self._last_error: float | None = None

    def step(self, error: float, feed: float = 0.0) -> float:
        """One tick: the output for this error, with `feed` added before the bound."""
        if self._kd_tick:
            last = error if self._last_error is None else self._last_error
            self._derivative = self._keep * self._derivative + self._kd_tick * (error - last)
            self._last_error = error
        integral = self._integral + self._ki_tick * error
        wanted = feed + self._kp * error + integral + self._derivative
        limit = self._limit
        if -limit <= wanted <= limit:
            self._integral = integral
            return wanted
        bounded = limit if wanted > limit else -limit
        if (error > 0) != (wanted > 0):
            self._integral = integral
        return bounded


class Controller:
    """Reference horizon and film voltage in, control output out, once a tick."""

    def __init__(
        self, scene: ControllerScene, pid: Pid, film: Film, law: ContactLaw | None, tick_s: float
    ) -> None:
        self._pid = pid
        self._volts_per_newton = film.volts_per_newton
        self._law = law
        self._feed_forward = scene.feed_forward
        self._tick_s = tick_s
        self._measure: Callable[[float], float] = {
            "force": _as_is,
            "millivolts": lambda force_n: 1e3 * film.volts(force_n),
            "position": law.position if law is not None else _as_is,
        }[scene.error]

    def output(self, reference_n: list[float], film_volts: float) -> float:
        """Control output for this tick: V for a voltage drive, m/s for a stepper.

        reference_n: the force wanted now and a tick later; film_volts: the feedback film.
        """
        measure = self._measure
        error = measure(reference_n[0]) - measure(film_volts / self._volts_per_newton)
        if self._feed_forward and self._law is not None:
            position = self._law.position
            feed = (position(reference_n[1]) - position(reference_n[0])) / self._tick_s
            return self._pid.step(error, feed)
        return self._pid.step(error)


def _as_is(force_n: float) -> float:
    return force_n
