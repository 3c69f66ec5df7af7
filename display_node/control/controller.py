"""The controller: from the reference's next samples and the film's reading to an output.

The output is a speed for a stepper and a voltage for the paper's second-order actuator.
"""

import math
from collections.abc import Callable
from typing import Annotated, Literal

from pydantic import Field, model_validator

from display_node.control.feed_forward import ScrewPath
from display_node.control.observer import Observer, ObserverScene
from display_node.control.pid import Pid
from display_node.control.stall_guard import StallGuard
from display_node.plant.contact import ContactLaw
from display_node.plant.filters import DelayLine
from display_node.plant.second_order import SecondOrder
from protocol.config.quantities import Hertz
from protocol.config.scene import Section


class ControllerScene(Section):
    """The `controller` table.

    error: what the PID sees. "force" in N; "millivolts" of the film by eq 21, the reading of
    the paper's gains that follows a pulse; "position" in m through the inverse contact law,
    which makes the loop's gain the same at every force. feed_forward: drive the reference's
    own motion without waiting for an error (stepper only). observer: see what is felt through
    a model of actuator and film (stepper only, error "position"). derivative_filter: corner of
    the derivative's low-pass. dead_band: an error within ±this is none, in the error's unit.
    """

    kp: Annotated[float, Field(ge=0, le=1e12)]
    ki: Annotated[float, Field(ge=0, le=1e12)] = 0.0
    kd: Annotated[float, Field(ge=0, le=1e12)] = 0.0
    derivative_filter_hz: Annotated[Hertz, Field(gt=0)] = 100.0
    error: Literal["force", "millivolts", "position"] = "force"
    feed_forward: bool = False
    observer: ObserverScene | None = None
    dead_band: Annotated[float, Field(ge=0)] = 0.0

    @model_validator(mode="after")
    def _observer_fits(self) -> "ControllerScene":
        if self.observer is not None and not (self.feed_forward and self.error == "position"):
            raise ValueError('an observer needs error = "position" and feed_forward = true')
        return self

    def pid(self, tick_s: float, limit: float) -> Pid:
        """The PID with these gains."""
        return Pid(
            self.kp, self.ki, self.kd, self.derivative_filter_hz, tick_s, limit, self.dead_band
        )


class StepperController:
    """Speed in m/s of a stepper, once a tick.

    latency_ticks: from a command to the reading that tells of it; play_m: the screw's.
    """

    def __init__(
        self,
        scene: ControllerScene,
        pid: Pid,
        law: ContactLaw,
        millivolts_per_newton: float,
        path: ScrewPath | None,
        observer: Observer | None,
        tick_s: float,
        slew_limit_n_per_s: float = math.inf,
        latency_ticks: float = 0.0,
        play_m: float = 0.0,
    ) -> None:
        self._pid = pid
        self._guard = StallGuard(law, tick_s, play_m)
        self._missed_ticks = 0
        self._position = law.position
        self._slew_limit_n_per_s = slew_limit_n_per_s
        self._stiffness = law.stiffness
        self._path = path
        self._observer = observer
        self._last_reading_n = 0.0
        self._late = DelayLine(latency_ticks) if latency_ticks else None
        self._wanted_n = 0.0
        self.horizon = path.horizon if path is not None else 1
        self._error: Callable[[float, float], tuple[float, float]]
        if scene.error == "position":
            self._error = lambda wanted_n, reading_n: (
                law.position(wanted_n) - law.position(reading_n),
                self._guard.held_s,
            )
        else:
            unit = millivolts_per_newton if scene.error == "millivolts" else 1.0
            self._error = lambda wanted_n, reading_n: (
                unit * (wanted_n - reading_n),
                unit * law.stiffness(reading_n) * self._guard.held_s,
            )

    def output(self, reference_n: list[float], reading_n: float) -> float:
        """Speed for this tick.

        reference_n: the force wanted now and in each of the next `horizon` ticks; reading_n:
        what the feedback film says now, NaN when it says nothing that can be true.
        """
        path, observer, guard = self._path, self._observer, self._guard
        guard.tick(self._missed_ticks, reference_n[0])
        self._missed_ticks = 0
        feed = path.advance(reference_n, guard.held_s) if path is not None else 0.0
        if path is not None and observer is not None:
            observer.correct(reading_n)
            error, response = path.screw_m - observer.screw_m, guard.held_s
        else:
            if reading_n == reading_n:
                self._last_reading_n = reading_n
            # A reading is to be compared with what was wanted when its command was given.
            self._wanted_n = reference_n[1]
            wanted_n = self._wanted_n if self._late is None else self._late.step(self._wanted_n)
            error, response = self._error(wanted_n, self._last_reading_n)
        if path is not None and path.further_m:
            error += response / guard.held_s * path.further_m
        # Making up for a lag, too, the force changes no faster than its limit allows; where more is
        # felt than wanted, the finger is stiffer. A reading may say more than was ever wanted.
        stiffest_n = max(reference_n[0], min(reading_n, guard.peak_n))
        fastest = self._slew_limit_n_per_s / (self._stiffness(stiffest_n) or 1e-9)
        pressing = fastest
        if guard.wary:
            screw_m = observer.screw_m if observer else self._position(self._last_reading_n)
            pressing = min(fastest, guard.fastest(screw_m))
        return self._pid.step(error, response, feed, -fastest, pressing)

    @property
    def finger_stiffness(self) -> float | None:
        """See `Observer.finger_stiffness`; None without an observer."""
        return None if self._observer is None else self._observer.finger_stiffness

    def skip(self, speed_m_per_s: float) -> None:
        """A tick was missed, in which the drive went on at a speed."""
        self._missed_ticks += 1
        if self._path is not None:
            self._path.skip(speed_m_per_s)
        if self._observer is not None:
            self._observer.skip()
        elif self._late is not None:
            self._late.step(self._wanted_n)

    def shift(self, way_m: float) -> None:
        """The screw has gone so much further than the last output says."""
        if self._path is not None:
            self._path.shift(way_m)
        if self._observer is not None:
            self._observer.shift(way_m)


class VoltageController:
    """Voltage of the paper's actuator, once a tick; `twin` models what it does."""

    horizon = 1

    def __init__(
        self, scene: ControllerScene, pid: Pid, millivolts_per_newton: float, twin: SecondOrder
    ) -> None:
        self._pid = pid
        self._twin = twin
        self._unit = millivolts_per_newton if scene.error == "millivolts" else 1.0

    def output(self, reference_n: list[float], reading_n: float) -> float:
        """Voltage for this tick; see `StepperController.output`."""
        twin, unit = self._twin, self._unit
        # Without a reading the twin's own force takes its place.
        if reading_n == reading_n:
            twin.force_n = reading_n
        reading_n = twin.force_n
        error = unit * (reference_n[1] - reading_n - twin.drift())
        volts = self._pid.step(error, unit * twin.response)
        twin.step(volts)
        return volts

    def skip(self, volts: float) -> None:
        """A tick was missed, in which the voltage was held."""
        self._twin.step(volts)
